"""A .npy file with a header that says something else than what follows, or is damaged."""

import io

import numpy as np


def header(shape):
    """An .npy whose header claims `shape`, with four numbers."""
    out = io.BytesIO()
    head = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(out, head)
    return out.getvalue() + b"\0" * 16


DAMAGED = {  # what NumPy says of each is no ValueError
    "a bracket is lost": header((2, 2)).replace(b"(2, 2)", b"(2, 2 "),
    "10^20 rows": header((10**20, 2)),
}
