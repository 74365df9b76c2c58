import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from quadwalk.errors import UsageError, UserError
from quadwalk.files import write_json
from quadwalk.runs import checkpoint
from quadwalk.runs import directory as run


@pytest.fixture
def made(tmp_path):
    """A new run, of the name "a"."""
    return run.create_run(tmp_path, "a")


def test_an_existing_name_is_refused_and_left_alone(made, tmp_path):
    made.policy.write_bytes(b"precious")
    with pytest.raises(UsageError, match=r"run 'a' exists in .*: choose another name"):
        run.create_run(tmp_path, "a")
    assert made.policy.read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("label", "seen"), [("walk", "-walk"), ("../../evil", "-..-..-evil"), ("x y" * 99, "-x-yx-y")]
)
def test_runs_without_a_name_do_not_collide(tmp_path, label, seen):
    root = tmp_path / "a" / "runs"
    names = {run.create_run(root, label=label).name for _ in range(3)}
    assert len(names) == 3
    assert all(seen in name for name in names)
    assert set(os.listdir(root)) == names


def test_of_two_runs_made_at_once_with_one_name_one_is(tmp_path):
    def make(_):
        try:
            return run.create_run(tmp_path, "a", files={"config.json": b"{}"})
        except UsageError as error:
            return str(error)

    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(make, range(8)))
    refused = [each for each in made if isinstance(each, str)]
    assert len(refused) == 7
    assert all("exists" in each for each in refused)
    assert os.listdir(tmp_path) == ["a"]
    assert run.Run(tmp_path / "a").config.read_bytes() == b"{}"


def test_a_folder_of_runs_is_no_run_and_links_lead_nowhere(tmp_path):
    root = tmp_path / "runs"
    for name in ("checkpoints", "config.json", "policy.npz"):
        run.create_run(root, name, files={"config.json": b"{}"})
        assert run.find_run(root, name).path == root / name
    assert run.list_runs(tmp_path) == []
    (root / "loop").symlink_to("loop")
    (root / "up").symlink_to("..")
    assert len(run.list_runs(root)) == 3
    for name in ("loop", "up"):
        with pytest.raises(UsageError, match="no run"):
            run.find_run(root, name)
        with pytest.raises(UsageError, match="exists"):
            run.create_run(root, name)


@pytest.mark.parametrize(
    "name",
    [
        *("", ".", "..", ".a", "-a", "a/b", "/a", "../a", "a\\b", "a b", "a\n", "a\0", "latest"),
        "x" * 101,
    ],
)
def test_names_that_cannot_be_are_refused(tmp_path, name):
    with pytest.raises(UsageError):
        run.create_run(tmp_path, name)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["a", "run_2", "2026-11-21_0815-run", "läufer", "v1.2+fast"])
def test_ordinary_names_are_taken(tmp_path, name):
    made = run.create_run(tmp_path / "runs", name)
    assert (made.path, made.name) == (tmp_path / "runs" / name, name)
    assert sorted(os.listdir(made.path)) == ["checkpoints", "tensorboard"]


def test_a_root_that_is_a_file_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    for root in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(UserError, match=r"cannot make the folder for runs, .*file") as caught:
            run.create_run(root, "a")
        assert caught.value.exit_status == 1


def test_a_run_that_could_not_be_made_leaves_nothing(tmp_path, monkeypatch):
    with pytest.raises(UserError, match="cannot write"):
        run.create_run(tmp_path, "b", files={"config.json": b"", "no/such/folder": b""})
    real = os.mkdir

    def full(path, *rest):
        if str(path).endswith("tensorboard"):
            raise OSError(28, "No space left on device")
        real(path, *rest)

    monkeypatch.setattr(os, "mkdir", full)
    with pytest.raises(UserError, match=r"cannot write in .*/a: No space left on device"):
        run.create_run(tmp_path, "a")
    assert os.listdir(tmp_path) == []


def make_runs(root, *names):
    """Runs, each last trained a second after the one before."""
    for second, name in enumerate(names):
        made = run.create_run(root, name)
        made.config.write_text("{}")
        os.utime(made.config, (1000 + second,) * 2)


def test_runs_are_found_by_name_path_and_age(tmp_path, monkeypatch):
    make_runs(tmp_path / "runs", "b", "c", "a")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "c" / "eval").mkdir()  # by an evaluation, which is no training
    assert run.find_run("runs", "latest").name == "a"
    for which in ("b", "runs/b", "runs/b/", str(tmp_path / "runs" / "b")):
        assert run.find_run("runs", which).name == "b"
    run.Run(tmp_path / "runs" / "b").metrics.write_text("")  # it goes on
    half = run.Run(tmp_path / "runs" / ".c-1.part")  # as a kill while it was made leaves it
    half.path.mkdir()
    half.config.write_text("{}")
    assert [found.name for found in run.list_runs(tmp_path / "runs")] == ["b", "a", "c"]
    assert run.find_run("runs", "latest").name == "b"


@pytest.mark.parametrize("which", ["x", "", " ", "..", "x/y", "x\0y", "y" * 5000])
def test_an_unknown_run_names_those_there_are(tmp_path, which):
    make_runs(tmp_path, *"abcdefgh")
    with pytest.raises(UsageError, match="h, g, f, e, d and 3 older") as caught:
        run.find_run(tmp_path, which)
    assert caught.value.exit_status == 2


def test_a_folder_or_file_that_is_no_run_is_refused(tmp_path):
    (tmp_path / "runs" / "empty").mkdir(parents=True)
    (tmp_path / "runs" / "file").write_text("")
    for which in ("empty", "file", "latest", str(tmp_path)):
        with pytest.raises(UsageError, match="yet"):
            run.find_run(tmp_path / "runs", which)
    with pytest.raises(UsageError, match="yet"):
        run.find_run(tmp_path / "nowhere", "latest")


def test_json_is_strict_and_replaces(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"b": [1, 2.5], "ä": None})
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"b": float("nan")})
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.json"]


def save(made, *steps):
    for count in steps:
        checkpoint.save(made.locate_checkpoint(count), {}, {"kind": "checkpoint", "steps": count})


def test_the_latest_checkpoint_is_by_steps_not_by_name_or_age(made):
    save(made, 2_000, 10_000, 900)
    (made.checkpoints / "step_5e9.npz").write_text("not one of ours")
    (made.checkpoints / "step_000000099999.npz.part").write_text("half")
    assert run.find_latest_checkpoint(made, print) == made.locate_checkpoint(10_000)


def test_a_damaged_checkpoint_is_skipped_with_a_warning_and_to_have_no_other_is_an_error(made):
    assert run.find_latest_checkpoint(made, pytest.fail) is None  # none at all is no error
    save(made, 1, 2)
    content = made.locate_checkpoint(2).read_bytes()
    made.locate_checkpoint(2).write_bytes(content[: len(content) // 2])
    warnings = []
    assert run.find_latest_checkpoint(made, warnings.append) == made.locate_checkpoint(1)
    assert len(warnings) == 1
    assert "step_000000000002.npz is damaged" in warnings[0]
    made.locate_checkpoint(1).write_bytes(b"")
    with pytest.raises(UserError, match="no checkpoint that can be read"):
        run.find_latest_checkpoint(made, warnings.append)


def test_the_last_few_are_kept(made):
    save(made, *range(5))
    run.prune_checkpoints(made, 2, also=made.locate_checkpoint(1))
    assert run.list_checkpoints(made) == [made.locate_checkpoint(count) for count in (1, 3, 4)]
    run.prune_checkpoints(made, 2)
    assert run.list_checkpoints(made) == [made.locate_checkpoint(3), made.locate_checkpoint(4)]
    with pytest.raises(ValueError, match="at least one"):
        run.prune_checkpoints(made, 0)


def test_what_interrupted_saves_left_is_deleted_and_what_an_evaluation_writes_is_not(made):
    save(made, 1)
    (made.path / "eval").mkdir()
    kept = made.path / "eval" / "a.mcap.part"
    left = [made.checkpoints / "step_000000000009.npz.part", made.path / "policy.npz.part"]
    for path in (kept, *left):
        path.write_text("half")
    run.delete_partial_files(made)
    assert kept.exists()
    assert not any(path.exists() for path in left)
    assert run.list_checkpoints(made) == [made.locate_checkpoint(1)]


def test_a_run_is_trained_by_one_at_a_time(made):
    expected = pytest.raises(UserError, match="a is being trained by another process")
    with run.claim(made), expected, run.claim(made):
        pass
    with run.claim(made):
        pass
    assert made.metrics.read_bytes() == b""
