import hashlib
import io
import json
import os
import pickle
import resource
import zipfile
from collections import namedtuple
from contextlib import contextmanager

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from quadwalk.errors import UserError
from quadwalk.train.runs import checkpoint

POLICY = {"kind": "policy"}

quick = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

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


@quick
@given(tree=trees().filter(lambda tree: tree is not None))  # like=None asks for a flat dict
def test_any_tree_comes_back_bit_for_bit(tmp_path, tree):
    path = tmp_path / "tree.npz"
    checkpoint.save(path, tree, {"kind": "checkpoint", "steps": 3})
    restored, metadata = checkpoint.load(path, "checkpoint", like=tree)
    same(restored, tree)
    assert metadata == {"kind": "checkpoint", "steps": 3}
    flat, _ = checkpoint.load(path, "checkpoint")
    assert len(flat) == len(jax.tree_util.tree_leaves(tree))


def training_state():
    params = {"hidden_0": {"kernel": jnp.ones((3, 2)), "bias": jnp.zeros(2)}}
    return {
        "params": params,
        "optimizer": optax.adam(1e-3).init(params),
        "key": jax.random.PRNGKey(7),
        "steps": np.int64(2**40),
    }


def test_a_training_state_comes_back_from_shapes_alone(tmp_path):
    state = training_state()
    checkpoint.save(tmp_path / "c.npz", state, {"kind": "checkpoint"})
    like = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state)
    same(checkpoint.load(tmp_path / "c.npz", "checkpoint", like=like)[0], state)


def test_numpy_alone_can_read_it(tmp_path):
    checkpoint.save(tmp_path / "c.npz", training_state(), {"kind": "checkpoint"})
    with np.load(tmp_path / "c.npz", allow_pickle=False) as file:
        assert file["params/hidden_0/kernel"].tolist() == [[1, 1]] * 3
        assert json.loads(file["metadata.json"])["format"] == "quadwalk"


def test_equal_trees_give_equal_bytes(tmp_path):
    square = np.arange(9.0).reshape(3, 3)
    for name, array in (("a", square), ("b", np.asfortranarray(square))):
        checkpoint.save(tmp_path / name, {"x": array}, POLICY)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    digest = hashlib.sha256((tmp_path / "a").read_bytes()).hexdigest()
    assert checkpoint.sha256(tmp_path / "a") == checkpoint.sha256(tmp_path / "b") == digest


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


def sample_bytes(tmp_path):
    checkpoint.save(tmp_path / "sample", SAMPLE, {"kind": "policy", "steps": 12})
    return (tmp_path / "sample").read_bytes()


def load_or_refuse(path):
    """Whether the file loads; if not, the refusal is one line that names it."""
    try:
        tree, metadata = checkpoint.load(path, "policy", like=SAMPLE)
    except UserError as error:
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        assert str(path) in refusal
        assert "\n" not in refusal
        return False
    same(tree, SAMPLE)
    assert metadata == {"kind": "policy", "steps": 12}
    return True


def test_a_file_cut_short_anywhere_is_refused(tmp_path):
    content = sample_bytes(tmp_path)
    path = tmp_path / "cut"
    for size in range(len(content)):
        path.write_bytes(content[:size])
        assert not load_or_refuse(path), size


@settings(quick, max_examples=200)
@given(data=st.data())
def test_flipped_bits_never_give_wrong_data(tmp_path, data):
    content = bytearray(sample_bytes(tmp_path))
    for bit in data.draw(st.lists(st.integers(0, 8 * len(content) - 1), min_size=1, max_size=3)):
        content[bit // 8] ^= 1 << (bit % 8)
    (tmp_path / "flipped").write_bytes(content)
    load_or_refuse(tmp_path / "flipped")  # some bits, such as dates, do not matter


@quick
@given(start=st.integers(0, 1500), piece=st.binary(max_size=64))
def test_overwritten_bytes_never_give_wrong_data(tmp_path, start, piece):
    content = bytearray(sample_bytes(tmp_path))
    content[start : start + len(piece)] = piece
    (tmp_path / "overwritten").write_bytes(content)
    load_or_refuse(tmp_path / "overwritten")


def zip_of(compression=zipfile.ZIP_STORED, **members):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("_", "."), content)
    return buffer.getvalue()


def header(**changes):
    return json.dumps(
        {"format": "quadwalk", "version": 1, "arrays": [], "metadata": POLICY} | changes
    )


def npz():
    buffer = io.BytesIO()
    np.savez(buffer, a=np.ones(3))
    return buffer.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello",
        pickle.dumps({"params": [1, 2]}),
        npz(),
        zip_of(metadata_json="{}"),
        zip_of(metadata_json="[1]"),
        zip_of(metadata_json="{"),
        zip_of(metadata_json="[" * 100_000),
        zip_of(metadata_json=header(format="other")),
        zip_of(metadata_json=header(metadata=None)),
        zip_of(metadata_json=header(metadata={})),
        zip_of(metadata_json=header(arrays=["a"])),
        zip_of(metadata_json=header(arrays=["a"]), a_npy=b"not an array"),
        zip_of(metadata_json=header(arrays=[3])),
        zip_of(metadata_json=header(), a_npy=b"not listed"),
        zip_of(zipfile.ZIP_DEFLATED, metadata_json=header()),
    ],
)
def test_a_foreign_file_is_refused(tmp_path, content):
    path = tmp_path / "foreign.npz"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"foreign\.npz is damaged or foreign: expected a policy"):
        checkpoint.load(path, "policy")


def test_a_pickle_inside_is_never_run(tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "sprung"),))

    buffer = io.BytesIO()
    np.save(buffer, np.array([Trap()], dtype=object), allow_pickle=True)
    content = zip_of(metadata_json=header(arrays=["a"]), a_npy=buffer.getvalue())
    (tmp_path / "trap.npz").write_bytes(content)
    with pytest.raises(UserError, match="damaged or foreign"):
        checkpoint.load(tmp_path / "trap.npz", "policy")
    assert not (tmp_path / "sprung").exists()


def test_a_newer_version_is_told_apart(tmp_path):
    (tmp_path / "new.npz").write_bytes(zip_of(metadata_json=header(version=2)))
    with pytest.raises(UserError, match=r"new\.npz has format version 2: expected 1"):
        checkpoint.load(tmp_path / "new.npz", "policy")


def test_the_kinds_are_told_apart(tmp_path):
    checkpoint.save(tmp_path / "c.npz", {}, {"kind": "checkpoint"})
    with pytest.raises(UserError, match=r"c\.npz is a checkpoint: expected a policy"):
        checkpoint.load(tmp_path / "c.npz", "policy")


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(UserError, match=r"none\.npz does not exist: expected a policy"):
        checkpoint.load(tmp_path / "none.npz", "policy")
    with pytest.raises(UserError, match="Is a directory"):
        checkpoint.load(tmp_path, "policy")
    with pytest.raises(UserError, match="cannot read"):
        checkpoint.sha256(tmp_path / "none.npz")


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
    sample_bytes(tmp_path)
    with pytest.raises(UserError, match=message):
        checkpoint.load(tmp_path / "sample", "policy", like=like)


@contextmanager
def files_at_most(size):
    """Let the system itself refuse to write beyond `size` bytes of a file."""
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


@pytest.mark.parametrize("room", [0, 100, 5000, 40_000])
def test_no_room_leaves_the_old_file(tmp_path, room):
    path = tmp_path / "c.npz"
    checkpoint.save(path, SAMPLE, POLICY)
    before = path.read_bytes()
    with files_at_most(room), pytest.raises(UserError, match=rf"cannot write {path}: "):
        checkpoint.save(path, {"a": np.ones(1000), "b": np.ones(10_000)}, POLICY)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["c.npz"]
