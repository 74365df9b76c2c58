"""Checkpoints and policies: a tree of arrays and its metadata in one file that cannot run code.

The file is a plain NumPy `.npz` (a zip archive, `np.load` opens it): one `.npy` member for each
leaf, named by its path in the tree ("params/hidden_0/kernel"), and `metadata.json`. No pickle, so
a file from a stranger is only ever data. Every byte of a member is covered by the archive's CRC-32
and the metadata lists the members, so damage is found before anything is used. Equal trees and
metadata give equal bytes.
"""

import io
import json
import lzma
import struct
import urllib.parse
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from quadwalk.errors import UserError
from quadwalk.files import DAMAGE, get_os_reason, open_atomic

FORMAT = "quadwalk"
VERSION = 1
KINDS = ("policy", "checkpoint", "nan")

_METADATA = "metadata.json"

# What zipfile and numpy raise, between them, on bytes that are not what they should be.
_DAMAGE = (
    *DAMAGE,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    SyntaxError,
)


def save(path: Path | str, tree: Any, metadata: dict[str, Any]) -> None:
    """Write `tree` and `metadata` to `path`, whole or not at all.

    `tree` is any JAX pytree whose leaves are real, integer, boolean or complex arrays or numbers
    (random keys as raw uint32). `metadata` is JSON data and names the "kind" of file, one of
    `KINDS`. Raises `UserError` when the system refuses (no space, no permission).
    """
    if metadata.get("kind") not in KINDS:
        raise ValueError(f"metadata['kind'] is {metadata.get('kind')!r}, expected one of {KINDS}")
    leaves = {name: _to_numpy(name, leaf) for name, leaf in _name_leaves(tree)[0]}
    header = {"format": FORMAT, "version": VERSION, "arrays": list(leaves), "metadata": metadata}
    text = json.dumps(header, indent=1)
    with open_atomic(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        # A bare ZipInfo is dated 1980: the time of writing must not change the bytes.
        archive.writestr(zipfile.ZipInfo(_METADATA), text)
        for name, leaf in leaves.items():
            large = leaf.nbytes > 2**30  # with room to the 2 GiB from which zip needs to know
            with archive.open(zipfile.ZipInfo(name + ".npy"), "w", force_zip64=large) as member:
                np.lib.format.write_array(member, leaf, allow_pickle=False)


def load(path: Path | str, kind: str, like: Any = None) -> tuple[Any, dict[str, Any]]:
    """Read a file that `save` wrote; return its tree of NumPy arrays and its metadata.

    With `like` (arrays or anything that has a shape and dtype, such as `jax.ShapeDtypeStruct`) the
    tree has the structure of `like`; without, it is a flat dict from path to array. Raises
    `UserError`, one line that names the file, if it is missing, damaged, foreign, of another
    kind, of a newer version, or does not fit `like`.
    """
    path = Path(path)
    try:
        file = open(path, "rb")  # noqa: SIM115 - opened apart, to tell what the system refuses...
    except FileNotFoundError:
        raise UserError(f"{path} does not exist: expected {_describe_kind(kind)}") from None
    except OSError as error:
        raise UserError(f"cannot read {path}: {get_os_reason(error)}") from error
    try:  # ...from what the content lacks.
        with file, zipfile.ZipFile(file) as archive:
            header = json.loads(_read_member(archive, _METADATA))
            if not isinstance(header, dict) or header["format"] != FORMAT:
                raise ValueError("another program's metadata")
            if header["version"] != VERSION:
                raise UserError(
                    f"{path} has format version {header['version']}: "
                    f"expected {VERSION} (was it written by a newer quadwalk?)"
                )
            saved_kind = header["metadata"]["kind"]
            if saved_kind != kind:
                raise UserError(f"{path} is a {saved_kind}: expected {_describe_kind(kind)}")
            leaves = _read_leaves(archive, header)
    except _DAMAGE as error:
        raise UserError(f"{path} is damaged or foreign: expected {_describe_kind(kind)}") from error
    return (leaves if like is None else fill_structure(path, leaves, like)), header["metadata"]


def fill_structure(path: Path, leaves: dict[str, np.ndarray], like: Any) -> Any:
    """Put the leaves of the file `path` into the structure of `like`, as `load` does.

    Raises `UserError` for what does not fit.
    """
    pairs, structure = _name_leaves(like)
    expected = dict(pairs)
    # States that version 0.1 saved have the acceleration that its contact solver started from.
    leaves = {name: leaf for name, leaf in leaves.items() if not name.endswith("physics/warmstart")}
    problems = [
        f"it has no {name}, expected {_describe(leaf)}"
        if name not in leaves
        else f"{name} is {_describe(leaves[name])}, expected {_describe(leaf)}"
        for name, leaf in expected.items()
        if name not in leaves or _describe(leaves[name]) != _describe(leaf)
    ]
    problems += [f"it has {name}, which is not expected" for name in leaves if name not in expected]
    if problems:
        more = f" (and {len(problems) - 1} more differences)" if len(problems) > 1 else ""
        raise UserError(f"{path} does not fit these settings: {problems[0]}{more}")
    return structure.unflatten([leaves[name] for name in expected])


def _describe_kind(kind: str) -> str:
    """Return what is expected in an error about a file that is not of this kind."""
    return f"a {kind} file that quadwalk's training wrote"


def _name_leaves(tree: Any) -> tuple[list[tuple[str, Any]], Any]:
    """Return the leaves of a tree with their paths as names, in order, and the tree's structure."""
    import jax  # not at the top: to list runs, or read a file into a dict, takes none of it

    def quote_key(key: Any) -> str:
        # Quoting keeps "a/b" apart from "a" -> "b", and odd characters out of the archive.
        return urllib.parse.quote(jax.tree_util.keystr((key,), simple=True), safe="")

    flat, structure = jax.tree_util.tree_flatten_with_path(tree)
    pairs = [("/".join(map(quote_key, keys)), leaf) for keys, leaf in flat]
    if len({name for name, _ in pairs}) < len(pairs):
        raise ValueError("two leaves of the tree have the same path")
    return pairs, structure


def _to_numpy(name: str, leaf: Any) -> np.ndarray:
    """Return a leaf as a little-endian array; `TypeError` for one that is not of plain numbers."""
    # order="C", so that how an array happens to lie in memory does not change the bytes.
    array = np.asarray(leaf, order="C")
    if array.dtype.kind not in "biufc":
        raise TypeError(f"cannot save {name}: {array.dtype} is not a plain number")
    return array.astype(array.dtype.newbyteorder("<"), copy=False)


def _read_leaves(archive: zipfile.ZipFile, header: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return the arrays of a file by their names; `ValueError` if `header` lists others."""
    names = header["arrays"]
    if archive.namelist() != [_METADATA, *(name + ".npy" for name in names)]:
        raise ValueError("the members are not those that the metadata lists")
    return {
        name: np.lib.format.read_array(
            io.BytesIO(_read_member(archive, name + ".npy")), allow_pickle=False
        )
        for name in names
    }


def _read_member(archive: zipfile.ZipFile, name: str) -> bytes:
    """Return the bytes of a member of the archive, after a check of their CRC."""
    # We never compress, so nothing read is larger than the file: no room for a zip bomb.
    if archive.getinfo(name).compress_type != zipfile.ZIP_STORED:
        raise ValueError("a compressed member")
    return archive.read(name)


def _describe(leaf: Any) -> str:
    """Return shape and dtype of an array, a number or a `ShapeDtypeStruct`: "(48, 128) float32"."""
    if not hasattr(leaf, "shape") or not hasattr(leaf, "dtype"):
        leaf = np.asarray(leaf)
    return f"{tuple(leaf.shape)} {leaf.dtype}"
