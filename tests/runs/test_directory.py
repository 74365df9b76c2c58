"""Runs as folders: how they are named, found, claimed and tidied."""

import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from quadwalk.errors import UsageError, UserError
from quadwalk.files import write_json
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import (
    Run,
    claim,
    create_run,
    delete_partial_files,
    find_latest_checkpoint,
    find_run,
    list_checkpoints,
    list_runs,
    prune_checkpoints,
)


@pytest.fixture
def run(tmp_path) -> Run:
    """Return a new run, of the name "a"."""
    return create_run(tmp_path, "a")


@pytest.mark.parametrize(
    ("label", "part"), [("walk", "-walk"), ("../../evil", "-..-..-evil"), ("x y" * 99, "-x-yx-y")]
)
def test_runs_without_a_name_do_not_collide(tmp_path, label, part):
    root = tmp_path / "a" / "runs"
    names = {create_run(root, label=label).name for _ in range(3)}
    assert len(names) == 3
    assert all(part in name for name in names)
    assert set(os.listdir(root)) == names


def test_of_runs_made_at_once_with_one_name_one_is(tmp_path):
    def make(number: int) -> Run | str:
        try:
            return create_run(tmp_path, "a", files={"config.json": b"%d" % number})
        except UsageError as error:
            return str(error)

    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(make, range(8)))
    (winner,) = (number for number, result in enumerate(results) if isinstance(result, Run))
    del results[winner]
    assert all(f"run 'a' exists in {tmp_path}: choose another name" == text for text in results)
    assert os.listdir(tmp_path) == ["a"]
    assert Run(tmp_path / "a").config.read_bytes() == b"%d" % winner


def test_a_folder_of_runs_is_no_run_and_links_lead_nowhere(tmp_path):
    root = tmp_path / "runs"
    for name in ("checkpoints", "config.json", "policy.npz"):
        create_run(root, name, files={"config.json": b"{}"})
        assert find_run(root, name).path == root / name
    assert list_runs(tmp_path) == []
    (root / "loop").symlink_to("loop")
    (root / "up").symlink_to("..")
    assert len(list_runs(root)) == 3
    for name in ("loop", "up"):
        with pytest.raises(UsageError, match="no run"):
            find_run(root, name)
        with pytest.raises(UsageError, match="exists"):
            create_run(root, name)


@pytest.mark.parametrize(
    "name",
    [
        *("", ".", "..", ".a", "-a", "a/b", "/a", "../a", "a\\b", "a b", "a\n", "a\0", "latest"),
        "x" * 101,
    ],
)
def test_names_that_cannot_be_are_refused(tmp_path, name):
    with pytest.raises(UsageError):
        create_run(tmp_path, name)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["run_2", "2026-11-21_0815-run", "läufer", "v1.2+fast"])
def test_ordinary_names_are_taken(tmp_path, name):
    run = create_run(tmp_path / "runs", name)
    assert (run.path, run.name) == (tmp_path / "runs" / name, name)
    assert sorted(os.listdir(run.path)) == ["checkpoints", "tensorboard"]


def test_a_run_that_could_not_be_made_leaves_nothing(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    for root in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(UserError, match=r"cannot make the folder for runs, .*file"):
            create_run(root, "a")
    with pytest.raises(UserError, match="cannot write"):
        create_run(tmp_path, "b", files={"config.json": b"", "no/such/folder": b""})
    mkdir = os.mkdir

    def refuse(path, *rest):
        if str(path).endswith("tensorboard"):
            raise OSError(28, "No space left on device")
        mkdir(path, *rest)

    monkeypatch.setattr(os, "mkdir", refuse)
    with pytest.raises(UserError, match=r"cannot write in .*/a: No space left on device"):
        create_run(tmp_path, "a")
    assert os.listdir(tmp_path) == ["file"]


def make_runs(root, *names):
    """Make runs, each last trained a second after the one before."""
    for second, name in enumerate(names):
        run = create_run(root, name)
        run.config.write_text("{}")
        os.utime(run.config, (1000 + second,) * 2)


def test_runs_are_found_by_name_path_and_age(tmp_path, monkeypatch):
    make_runs(tmp_path / "runs", "b", "c", "a")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "c" / "eval").mkdir()  # by an evaluation, which is no training
    assert find_run("runs", "latest").name == "a"
    for which in ("b", "runs/b", "runs/b/", str(tmp_path / "runs" / "b")):
        assert find_run("runs", which).name == "b"
    Run(tmp_path / "runs" / "b").metrics.write_text("")  # it is resumed
    half = Run(tmp_path / "runs" / ".c-1.part")  # as a kill while it was made leaves it
    half.path.mkdir()
    half.config.write_text("{}")
    assert [run.name for run in list_runs(tmp_path / "runs")] == ["b", "a", "c"]
    assert find_run("runs", "latest").name == "b"


@pytest.mark.parametrize("which", ["x", "", " ", "..", "x/y", "x\0y", "y" * 5000])
def test_an_unknown_run_names_those_there_are(tmp_path, which):
    make_runs(tmp_path, *"abcdefgh")
    with pytest.raises(UsageError, match="h, g, f, e, d and 3 older") as caught:
        find_run(tmp_path, which)
    assert caught.value.exit_status == 2


def test_a_folder_or_file_that_is_no_run_is_refused(tmp_path):
    (tmp_path / "runs" / "empty").mkdir(parents=True)
    (tmp_path / "runs" / "file").write_text("")
    for which in ("empty", "file", "latest", str(tmp_path)):
        with pytest.raises(UsageError, match="yet"):
            find_run(tmp_path / "runs", which)
    with pytest.raises(UsageError, match="yet"):
        find_run(tmp_path / "nowhere", "latest")


def test_json_is_strict_and_replaces(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"b": [1, 2.5], "ä": None})
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"b": float("nan")})
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.json"]


def save(run: Run, *steps: int) -> None:
    for count in steps:
        path = run.locate_checkpoint(count)
        checkpoint.save(path, {}, {"kind": "checkpoint", "steps": count})


def test_the_latest_checkpoint_is_the_last_by_steps_that_can_be_read(run):
    assert find_latest_checkpoint(run, pytest.fail) is None  # none at all is no error
    save(run, 2_000, 10_000, 900)
    (run.checkpoints / "step_5e9.npz").write_text("not one of ours")
    (run.checkpoints / "step_000000099999.npz.part").write_text("half")
    assert find_latest_checkpoint(run, print) == run.locate_checkpoint(10_000)
    content = run.locate_checkpoint(10_000).read_bytes()
    run.locate_checkpoint(10_000).write_bytes(content[: len(content) // 2])
    warnings = []
    assert find_latest_checkpoint(run, warnings.append) == run.locate_checkpoint(2_000)
    assert len(warnings) == 1
    assert "step_000000010000.npz is damaged" in warnings[0]
    for path in list_checkpoints(run):
        path.write_bytes(b"")
    with pytest.raises(UserError, match="no checkpoint that can be read"):
        find_latest_checkpoint(run, warnings.append)


def test_the_last_few_are_kept(run):
    save(run, *range(5))
    prune_checkpoints(run, 2, also=(run.locate_checkpoint(1),))
    assert list_checkpoints(run) == [run.locate_checkpoint(steps) for steps in (1, 3, 4)]
    prune_checkpoints(run, 2)
    assert list_checkpoints(run) == [run.locate_checkpoint(steps) for steps in (3, 4)]


def test_what_interrupted_saves_left_is_deleted_and_what_an_evaluation_writes_is_not(run):
    (run.path / "eval").mkdir()
    evaluation = run.path / "eval" / "a.mcap.part"
    partial = [run.checkpoints / "step_000000000009.npz.part", run.path / "policy.npz.part"]
    for path in (evaluation, *partial):
        path.write_text("half")
    delete_partial_files(run)
    assert evaluation.exists()
    assert not any(path.exists() for path in partial)


def test_a_run_is_trained_by_one_at_a_time(run):
    expected = pytest.raises(UserError, match="a is being trained by another process")
    with claim(run), expected, claim(run):
        pass
    with claim(run):
        pass
    assert run.metrics.read_bytes() == b""
