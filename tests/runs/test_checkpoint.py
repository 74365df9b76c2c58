import hashlib
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
from quadwalk.files import hash_file
from quadwalk.runs import checkpoint

POLICY = {"kind": "policy"}

Pair = namedtuple("Pair", "first second")


@flax.struct.dataclass
class Struct:
    weight: jax.Array
    rest: dict


def arrays():
    return hnp.arrays(
        st.sampled_from([np.float32, np.float64, np.int32, np.uint32, np.int8, np.bool_]),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3),
    )


def trees():
    return st.recursive(
        arrays() | st.none(),
        lambda inner: (
            st.dictionaries(st.text(max_size=4), inner, max_size=3)
            | st.lists(inner, max_size=3)
            | st.lists(inner, max_size=3).map(tuple)
            | st.builds(Pair, inner, inner)
            | st.builds(Struct, inner, st.dictionaries(st.text(max_size=2), inner, max_size=2))
        ),
        max_leaves=6,
    )


def same(a, b):
    assert jax.tree_util.tree_structure(a) == jax.tree_util.tree_structure(b)
    for x, y in zip(jax.tree_util.tree_leaves(a), jax.tree_util.tree_leaves(b), strict=True):
        x, y = np.asarray(x), np.asarray(y)
        assert (x.dtype, x.shape, x.tobytes()) == (y.dtype, y.shape, y.tobytes())


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(tree=trees().filter(lambda tree: tree is not None))  # like=None asks for a flat dict
def test_any_tree_comes_back_bit_for_bit(tmp_path, tree):
    path = tmp_path / "tree.npz"
    checkpoint.save(path, tree, {"kind": "checkpoint", "steps": 3})
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), tree)
    for like in (tree, shapes):
        restored, metadata = checkpoint.load(path, "checkpoint", like=like)
        same(restored, tree)
        assert metadata == {"kind": "checkpoint", "steps": 3}
    flat, _ = checkpoint.load(path, "checkpoint")
    assert len(flat) == len(jax.tree_util.tree_leaves(tree))


def test_numpy_alone_can_read_it(tmp_path):
    params = {"hidden_0": {"kernel": jnp.ones((3, 2))}}
    checkpoint.save(tmp_path / "c.npz", {"params": params}, {"kind": "checkpoint"})
    with np.load(tmp_path / "c.npz", allow_pickle=False) as file:
        assert file["params/hidden_0/kernel"].tolist() == [[1, 1]] * 3
        assert json.loads(file["metadata.json"])["format"] == "quadwalk"


def test_equal_trees_give_equal_bytes(tmp_path):
    square = np.arange(9.0).reshape(3, 3)
    for name, array in (("a", square), ("b", np.asfortranarray(square))):
        checkpoint.save(tmp_path / name, {"x": array}, POLICY)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    digest = hashlib.sha256((tmp_path / "a").read_bytes()).hexdigest()
    assert hash_file(tmp_path / "a") == hash_file(tmp_path / "b") == digest


@pytest.mark.parametrize(
    "leaf",
    [np.array([object()]), np.array(["text"]), jnp.ones(2, jnp.bfloat16), jax.random.key(0)],
    ids=["object", "text", "bfloat16", "typed key"],
)
def test_what_is_not_plain_numbers_is_not_saved(tmp_path, leaf):
    with pytest.raises(TypeError):
        checkpoint.save(tmp_path / "c.npz", {"x": leaf}, POLICY)
    assert os.listdir(tmp_path) == []


SAMPLE = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": (np.int32(5), np.ones(3))}


def zip_of(metadata, compression=zipfile.ZIP_STORED, **arrays):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        archive.writestr("metadata.json", metadata)
        for name, content in arrays.items():
            archive.writestr(f"{name}.npy", content)
    return buffer.getvalue()


def header(**changes):
    return json.dumps(
        {"format": "quadwalk", "version": 1, "arrays": [], "metadata": POLICY} | changes
    )


def saved(save, *args, **kwargs):
    buffer = io.BytesIO()
    save(buffer, *args, **kwargs)
    return buffer.getvalue()


FOREIGN = [
    b"",
    b"hello",
    pickle.dumps({"params": [1, 2]}),
    saved(np.savez, a=np.ones(3)),
    *(zip_of(text) for text in ("{}", "[1]", "{", "[" * 100_000)),
    zip_of(header(format="other")),
    *(zip_of(header(metadata=metadata)) for metadata in (None, {})),
    *(zip_of(header(arrays=arrays)) for arrays in (["a"], [3])),
    zip_of(header(arrays=["a"]), a=b"not an array"),
    zip_of(header(), a=b"not listed"),
    zip_of(header(), zipfile.ZIP_DEFLATED),
]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        *((content, "is damaged or foreign: expected a policy") for content in FOREIGN),
        (zip_of(header(version=2)), "has format version 2: expected 1"),
        (zip_of(header(metadata={"kind": "checkpoint"})), "is a checkpoint: expected a policy"),
    ],
)
def test_a_file_that_is_no_policy_is_refused(tmp_path, content, said):
    path = tmp_path / "foreign.npz"
    path.write_bytes(content)
    with pytest.raises(UserError, match=rf"foreign\.npz {said}"):
        checkpoint.load(path, "policy")


def test_a_pickle_inside_is_never_run(tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "sprung"),))

    array = saved(np.save, np.array([Trap()], dtype=object), allow_pickle=True)
    (tmp_path / "trap.npz").write_bytes(zip_of(header(arrays=["a"]), a=array))
    with pytest.raises(UserError, match="damaged or foreign"):
        checkpoint.load(tmp_path / "trap.npz", "policy")
    assert not (tmp_path / "sprung").exists()


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(UserError, match=r"none\.npz does not exist: expected a policy"):
        checkpoint.load(tmp_path / "none.npz", "policy")
    with pytest.raises(UserError, match="Is a directory"):
        checkpoint.load(tmp_path, "policy")
    with pytest.raises(UserError, match="cannot read"):
        hash_file(tmp_path / "none.npz")


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
    old = resource.getrlimit(resource.RLIMIT_FSIZE)  # the system itself refuses to write more
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, old[1]))
    try:
        with pytest.raises(UserError, match=rf"cannot write {path}: "):
            checkpoint.save(path, {"a": np.ones(1000), "b": np.ones(10_000)}, POLICY)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["c.npz"]
