"""Lets compiled CPU programs call a Python function, without any JAX code inside the call.

Why not `jax.pure_callback`: it converts its arguments to JAX arrays, which on a machine with few
cores can wait for the very thread that the call occupies; and JAX never caches a program with such
a call. Here XLA's C interface for foreign functions (jaxlib/include/xla/ffi/api/c_api.h, whose
names these structures have) passes the arrays' addresses, and the program is cached as any other.

Call it with `has_side_effect=True`: JAX then waits for the program before Python ends. Otherwise a
running program could call into a Python that is gone, and the process would hang or crash.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import POINTER, c_char_p, c_int, c_int64, c_size_t, c_uint32, c_void_p, cast

import jax
import numpy as np

METADATA, INTERNAL = 1, 13  # XLA_FFI_Extension_Metadata, XLA_FFI_Error_Code_INTERNAL
FLOAT32 = 11  # XLA_FFI_DataType_F32
VERSION = 0, 3  # XLA_FFI_API_MAJOR, _MINOR


def _struct(name: str, *fields: tuple[str, type]) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": list(fields)})


_BASE = ("struct_size", c_size_t), ("extension_start", c_void_p)
_Extension = _struct("Extension", ("struct_size", c_size_t), ("type", c_int), ("next", c_void_p))
_Version = _struct("Version", *_BASE, ("major", c_int), ("minor", c_int))
_Metadata = _struct(
    "Metadata", ("struct_size", c_size_t), ("version", _Version), ("traits", c_uint32)
)
_MetadataExtension = _struct(
    "MetadataExtension", ("base", _Extension), ("metadata", POINTER(_Metadata))
)
_Buffer = _struct(
    "Buffer",
    *_BASE,
    ("dtype", c_int),
    ("data", c_void_p),
    ("rank", c_int64),
    ("dims", POINTER(c_int64)),
)
_Buffers = _struct(
    "Buffers",
    *_BASE,
    ("size", c_int64),
    ("types", c_void_p),
    ("at", POINTER(POINTER(_Buffer))),
)
_Frame = _struct(
    "Frame",
    *_BASE,
    ("api", c_void_p),
    ("context", c_void_p),
    ("stage", c_int),
    ("args", _Buffers),
    ("rets", _Buffers),
)
_Failure = _struct("Failure", *_BASE, ("message", c_char_p), ("code", c_int))
_CREATE_ERROR = ctypes.CFUNCTYPE(c_void_p, POINTER(_Failure))
_Api = _struct("Api", *_BASE, ("version", _Version), ("internal", c_void_p), ("fail", c_void_p))
_HANDLER = ctypes.CFUNCTYPE(c_void_p, POINTER(_Frame))

_HANDLERS: dict[str, object] = {}  # XLA has no way to forget a target


def registered(name: str) -> bool:
    """Whether a function of this name is registered."""
    return name in _HANDLERS


def register(name: str, function: Callable[[list[np.ndarray], list[np.ndarray]], None]) -> None:
    """Let programs call `function(arguments, results)` as `jax.ffi.ffi_call(name, ...)`.

    Both are lists of float32 arrays in XLA's own memory: fill the results, do not change the
    arguments. An exception in it ends the program with a JaxRuntimeError. A name is registered only
    once.
    """
    if name in _HANDLERS:
        return

    @_HANDLER
    def handler(frame):
        frame = frame.contents
        if frame.extension_start:  # at registration XLA asks for the API version
            extension = cast(frame.extension_start, POINTER(_MetadataExtension)).contents
            if extension.base.type == METADATA:
                version = extension.metadata.contents.version
                version.major, version.minor = VERSION
                return None
        try:
            function(_arrays(frame.args), _arrays(frame.rets))
        except BaseException as error:  # an exception must not pass through C
            return _fail(frame, f"{type(error).__name__}: {error}")
        return None

    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(handler), platform="cpu")
    _HANDLERS[name] = handler


def _arrays(buffers) -> list[np.ndarray]:
    return [_array(buffers.at[i].contents) for i in range(buffers.size)]


def _array(buffer) -> np.ndarray:
    if buffer.dtype != FLOAT32:
        raise TypeError(f"an array of XLA's type {buffer.dtype}, expected float32")
    shape = tuple(buffer.dims[: buffer.rank])
    if not np.prod(shape):
        return np.empty(shape, np.float32)
    return np.ctypeslib.as_array(cast(buffer.data, POINTER(ctypes.c_float)), shape)


def _fail(frame, message: str):
    api = cast(frame.api, POINTER(_Api)).contents
    failure = _Failure(ctypes.sizeof(_Failure), None, message.encode(), INTERNAL)
    return _CREATE_ERROR(api.fail)(ctypes.byref(failure))
