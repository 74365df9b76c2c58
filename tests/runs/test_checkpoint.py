"""Archives of arrays: any tree comes back, and nothing else is taken for one."""

import io
import json
import os
import pickle
import resource
import zipfile
from collections import namedtuple

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from quadwalk.errors import UserError
from quadwalk.runs import checkpoint

POLICY = {"kind": "policy"}
SAMPLE = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": (np.int32(5), np.ones(3))}

Pair = namedtuple("Pair", "first second")


@flax.struct.dataclass
class Struct:
    weight: jax.Array
    rest: dict


ARRAYS = hnp.arrays(
    st.sampled_from([np.float32, np.float64, np.int32, np.uint32, np.int8, np.bool_]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3),
)
TREES = st.recursive(
    ARRAYS | st.none(),
    lambda inner: (
        st.dictionaries(st.text(max_size=4), inner, max_size=3)
        | st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.builds(Pair, inner, inner)
        | st.builds(Struct, inner, st.dictionaries(st.text(max_size=2), inner, max_size=2))
    ),
    max_leaves=6,
).filter(lambda tree: tree is not None)  # like=None asks for a flat dict


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(tree=TREES)
def test_any_tree_comes_back_bit_for_bit(tmp_path, tree):
    path = tmp_path / "tree.npz"
    checkpoint.save(path, tree, {"kind": "checkpoint", "steps": 3})
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), tree)
    leaves, structure = jax.tree.flatten(tree)
    for like in (tree, shapes):
        restored, metadata = checkpoint.load(path, "checkpoint", like=like)
        assert jax.tree.structure(restored) == structure
        for new, old in zip(jax.tree.leaves(restored), leaves, strict=True):
            assert (new.dtype, new.shape, new.tobytes()) == (old.dtype, old.shape, old.tobytes())
        assert metadata == {"kind": "checkpoint", "steps": 3}
    assert len(checkpoint.load(path, "checkpoint")[0]) == len(leaves)


def test_numpy_alone_can_read_it_and_equal_trees_give_equal_bytes(tmp_path):
    kernel = np.arange(9.0).reshape(3, 3)
    for name, array in (("a", kernel), ("b", np.asfortranarray(kernel)), ("c", jnp.array(kernel))):
        params = {"hidden_0": {"kernel": array.astype(np.float32)}}
        checkpoint.save(tmp_path / name, {"params": params}, POLICY)
        assert (tmp_path / name).read_bytes() == (tmp_path / "a").read_bytes()
    with np.load(tmp_path / "a", allow_pickle=False) as file:
        assert file["params/hidden_0/kernel"].tolist() == kernel.tolist()
        assert json.loads(file["metadata.json"])["format"] == "quadwalk"


@pytest.mark.parametrize(
    "leaf",
    [np.array([object()]), np.array(["text"]), jnp.ones(2, jnp.bfloat16), jax.random.key(0)],
    ids=["object", "text", "bfloat16", "typed key"],
)
def test_what_is_not_plain_numbers_is_not_saved(tmp_path, leaf):
    with pytest.raises(TypeError):
        checkpoint.save(tmp_path / "c.npz", {"x": leaf}, POLICY)
    assert os.listdir(tmp_path) == []


def make_zip(metadata: str, compression: int = zipfile.ZIP_STORED, **arrays: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        archive.writestr("metadata.json", metadata)
        for name, content in arrays.items():
            archive.writestr(f"{name}.npy", content)
    return buffer.getvalue()


def make_header(**changes: object) -> str:
    header = {"format": "quadwalk", "version": 1, "arrays": [], "metadata": POLICY}
    return json.dumps(header | changes)


def get_bytes(save, *args, **kwargs) -> bytes:
    buffer = io.BytesIO()
    save(buffer, *args, **kwargs)
    return buffer.getvalue()


FOREIGN = (
    *(b"", b"hello", pickle.dumps({"params": [1, 2]}), get_bytes(np.savez, a=np.ones(3))),
    *(make_zip(text) for text in ("{}", "[1]", "{", "[" * 100_000, make_header(format="other"))),
    *(make_zip(make_header(metadata=metadata)) for metadata in (None, {})),
    *(make_zip(make_header(arrays=arrays)) for arrays in (["a"], [3])),
    make_zip(make_header(arrays=["a"]), a=b"not an array"),
    make_zip(make_header(), a=b"not listed"),
    make_zip(make_header(), zipfile.ZIP_DEFLATED),
)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        *((content, "is damaged or foreign: expected a policy") for content in FOREIGN),
        (make_zip(make_header(version=2)), "has format version 2: expected 1"),
        (make_zip(make_header(metadata={"kind": "nan"})), "is a nan: expected a policy"),
    ],
)
def test_a_file_that_is_no_policy_is_refused(tmp_path, content, message):
    path = tmp_path / "foreign.npz"
    path.write_bytes(content)
    with pytest.raises(UserError, match=rf"foreign\.npz {message}"):
        checkpoint.load(path, "policy")


def test_a_pickle_inside_is_never_run(tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "sprung"),))

    array = get_bytes(np.save, np.array([Trap()], dtype=object), allow_pickle=True)
    (tmp_path / "trap.npz").write_bytes(make_zip(make_header(arrays=["a"]), a=array))
    with pytest.raises(UserError, match="damaged or foreign"):
        checkpoint.load(tmp_path / "trap.npz", "policy")
    assert not (tmp_path / "sprung").exists()


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(UserError, match=r"none\.npz does not exist: expected a policy"):
        checkpoint.load(tmp_path / "none.npz", "policy")
    with pytest.raises(UserError, match="Is a directory"):
        checkpoint.load(tmp_path, "policy")


@pytest.mark.parametrize(
    ("like", "message"),
    [
        ({**SAMPLE, "a": np.ones((2, 4), np.float32)}, r"a is \(2, 3\) float32, expected \(2, 4\)"),
        ({**SAMPLE, "a": np.ones((2, 3), np.int32)}, r"a is \(2, 3\) float32, .* int32$"),
        ({**SAMPLE, "c": np.ones(2)}, r"it has no c, expected \(2,\) float64"),
        ({"a": SAMPLE["a"]}, r"it has b/0, which is not expected \(and 1 more differences\)"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, like, message):
    checkpoint.save(tmp_path / "sample", SAMPLE, POLICY)
    with pytest.raises(UserError, match=message):
        checkpoint.load(tmp_path / "sample", "policy", like=like)


@pytest.mark.parametrize("room", [0, 100, 5000, 40_000])
def test_no_room_leaves_the_old_file(tmp_path, room):
    path = tmp_path / "c.npz"
    checkpoint.save(path, SAMPLE, POLICY)
    before = path.read_bytes()
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)  # the system itself refuses to write more
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limit[1]))
    try:
        with pytest.raises(UserError, match=rf"cannot write {path}: "):
            checkpoint.save(path, {"a": np.ones(1000), "b": np.ones(10_000)}, POLICY)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["c.npz"]
