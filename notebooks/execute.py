"""Run notebooks and write their outputs into them.

    .venv/bin/python notebooks/execute.py                                 # 01 to 04, some ten minutes
    .venv/bin/python notebooks/execute.py notebooks/03_model_error.ipynb

Run it after a change to a notebook (or `make notebooks`), look at the pictures, and commit. Needs the
extras `dev` and `video`. What a notebook may hold is in tests/test_notebooks.py.
"""

import argparse
import base64
import io
import os
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

HERE = Path(__file__).resolve().parent
COLOURS = 128  # of a PNG: enough for lines and maps


def execute(path: Path) -> None:
    """Run every cell of the notebook in its folder, and save it with its outputs."""
    notebook = nbformat.read(path, as_version=4)
    metadata = dict(notebook.metadata)
    how = {"kernel_name": "python3", "record_timing": False, "coalesce_streams": True}
    client = NotebookClient(notebook, timeout=900, **how)
    client.resources = {"metadata": {"path": str(path.parent)}}
    folders = str(HERE.parent), os.environ.get("PYTHONPATH", "")
    client.execute(env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, folders))})
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = fewer_colours(data["image/png"])
    notebook.metadata = nbformat.from_dict(metadata)  # the kernel adds its own version
    nbformat.write(notebook, path)


def fewer_colours(text: str) -> str:
    """A PNG (base64) with `COLOURS` colours; as it is where that is not smaller."""
    content = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(text))) as picture:
        flat = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    flat.save(content, "png", optimize=True)
    return min(base64.b64encode(content.getvalue()).decode(), text, key=len)


def main() -> None:
    parser = argparse.ArgumentParser(description="Run notebooks and write their outputs into them.")
    parser.add_argument("notebooks", nargs="*", type=Path, help="without one: 01 to 04")
    for path in parser.parse_args().notebooks or sorted(HERE.glob("0[1-4]_*.ipynb")):
        began = time.monotonic()
        execute(path)
        size = path.stat().st_size / 1000
        print(f"{path.name}: {time.monotonic() - began:.0f} s, {size:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
