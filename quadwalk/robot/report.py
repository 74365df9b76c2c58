"""Notes on how a robot was read and converted, and the error for one that cannot be."""

import re

from quadwalk.errors import UserError

_KINDS = ("fused", "repaired", "dropped", "assumed")


class UrdfError(UserError):
    """A URDF that cannot be read, or describes no robot that can exist, in one line."""

    def __init__(self, message: str):
        # Names and values in it are the file's, which may hold line breaks or be endless.
        line = re.sub(r"[\x00-\x1f\x7f-\x9f]+", " ", message)
        super().__init__(line if len(line) <= 800 else line[:500] + " ... " + line[-250:])


class Report:
    """Notes on what conversion fused, repaired, dropped and assumed, in the URDF's order."""

    def __init__(self) -> None:
        self._notes: dict[str, dict[str, list[str]]] = {kind: {} for kind in _KINDS}

    def add(self, kind: str, note: str, element: str = "") -> None:
        """Add a note on the link, joint or file called `element`; "" is the whole robot.

        `kind` is "fused", "repaired", "dropped" or "assumed". Elements with one note share a line.
        """
        elements = self._notes[kind].setdefault(note, [])
        if element and element not in elements:
            elements.append(element)

    def to_lines(self, most: int = 4) -> list[str]:
        """Return lines of text, each naming at most `most` elements."""
        lines = []
        for kind, notes in self._notes.items():
            for note, elements in notes.items():
                listing = ", ".join(" ".join(name.splitlines()) for name in elements[:most])
                more = f" and {len(elements) - most} more" if len(elements) > most else ""
                lines.append(f"{kind}: {note}" + (f": {listing}{more}" if elements else ""))
        return lines
