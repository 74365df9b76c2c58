"""Many episodes in cells of equal size, of which no more than the trunk's path is kept."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import State
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.simulate import Policy, Report, roll_out
from quadwalk.evaluation.statistics import mean_figure, share_interval

# An episode's number, whether it came to its end without a fall, and its trunk's poses (T + 1, 7),
# m and wxyz, to its figures.
Measure = Callable[[int, bool, np.ndarray], dict[str, float | bool]]


def measure_cells(
    env: QuadrupedEnv,
    policy: Policy,
    starts: State,
    episodes: int,
    measure: Measure,
    room: int | None = None,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Success and the figures of each cell, `episodes` of `starts` (n, ...) on end, for JSON.

    `success` is the share without a fall, `success_ci95` its interval. Of a figure there is the
    `mean_figure`, or of one that is true or false its share. At most `room` episodes go at a
    time, by default all.
    """
    found: dict[int, dict[str, float | bool]] = {}
    room = room and min(room, len(starts.obs))
    for number, upright, poses in trunk_paths(env, policy, starts, room, report):
        found[number] = {"success": upright} | measure(number, upright, poses)
    return [
        _figures([found[start + k] for k in range(episodes)])
        for start in range(0, len(found), episodes)
    ]


def trunk_paths(
    env: QuadrupedEnv, policy: Policy, starts: State, *options: Any, **others: Any
) -> Iterator[tuple[int, bool, np.ndarray]]:
    """What a `Measure` takes of each episode, when it ends; `options` are of `roll_out`."""
    first = np.asarray(starts.pipeline_state.qpos[:, :7])
    for number, end, path in roll_out(env, policy, starts, _pose, *options, **others):
        poses = np.concatenate([first[number, None], path])
        yield number, end == "time limit", poses.astype(float)


def cell_starts(
    env: QuadrupedEnv, start: Callable[..., State], cells: np.ndarray, *episodes: Any
) -> State:
    """The starts (m * n, ...) of n `episodes` in each of m `cells`, one cell after another.

    Each is `start(env, cell, *episode)`; `cells` are (m, ...), `episodes` (n, ...).
    """

    @jax.jit
    def begun(env: QuadrupedEnv, cells: jax.Array, *episodes: Any) -> State:
        of_cell = jax.vmap(partial(start, env), in_axes=(None, *(0 for _ in episodes)))
        return jax.vmap(of_cell, in_axes=(0, *(None for _ in episodes)))(cells, *episodes)

    states = begun(env, jnp.asarray(cells), *episodes)
    flat: State = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), states)
    return flat


def _pose(env: QuadrupedEnv, before: State, action: jax.Array, after: State) -> jax.Array:
    """(n, 7) of the trunk, m and wxyz, to be watched."""
    qpos: jax.Array = after.pipeline_state.qpos
    return qpos[:, :7]


def _figures(found: Sequence[dict[str, float | bool]]) -> dict[str, Any]:
    """The figures of one cell from those of its episodes."""
    figures: dict[str, Any] = {}
    for name, example in found[0].items():
        values = [each[name] for each in found]
        figures[name] = (
            sum(values) / len(values) if isinstance(example, bool) else mean_figure(values)
        )
    succeeded = sum(bool(each["success"]) for each in found)
    return figures | {"success_ci95": list(share_interval(succeeded, len(found)))}
