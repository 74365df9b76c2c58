"""What comes back from jobs. Of quadwalk it imports nothing: where news is kept, nothing trains."""

from typing import Any, Literal, NamedTuple

Row = dict[str, float]
Files = dict[str, bytes]  # of a run, by their paths in its folder


class Event(NamedTuple):
    """What has become of a job: a row of metrics, one more beginning, or its end."""

    name: str
    kind: Literal["row", "again", "done", "failed", "stopped"]
    value: Any = None  # the row; what `judge` returned; why it failed


class Keeper:
    """Holds the newest files of each run, for the next attempt; an actor."""

    def __init__(self) -> None:
        self._files: dict[str, Files] = {}
        self._tries: dict[str, int] = {}
        self._stopped: set[str] = set()
        self._news: list[tuple[Event, Files, list[str]]] = []

    def hand(self, name: str, files: Files) -> None:
        self._files[name], self._tries[name] = files, 0

    def begin(self, name: str) -> tuple[int, Files]:
        """The number of this try, and the files it begins with."""
        self._tries[name] += 1
        if self._tries[name] > 1:
            self._news.append((Event(name, "again"), {}, []))
        return self._tries[name], self._files[name]

    def tell(self, name: str, number: int, row: Row | None, files: Files, kept: list[str]) -> bool:
        """Take news of try `number`: a row, and files that are new if any of `kept`, all it has.

        Whether the try should end: it was stopped, or another has begun since.
        """
        if number != self._tries.get(name):
            return True
        if files:
            known = {**self._files[name], **files}
            self._files[name] = {path: known[path] for path in kept}
        if files or row:
            self._news.append((Event(name, "row", row), files, kept))
        return name in self._stopped

    def news(self) -> list[tuple[Event, Files, list[str]]]:
        """What was reported since the last call."""
        news, self._news = self._news, []
        return news

    def stop(self, name: str) -> None:
        self._stopped.add(name)

    def drop(self, name: str) -> None:
        """Forget a run that is done."""
        for held in (self._files, self._tries):
            held.pop(name, None)
