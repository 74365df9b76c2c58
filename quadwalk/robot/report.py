"""What is to be said about how a conversion came about."""

_KINDS = ("fused", "repaired", "dropped", "assumed")  # of notes in a report


class Report:
    """What conversion fused, repaired, dropped and assumed, in the URDF's order."""

    def __init__(self) -> None:
        self.found: dict[str, dict[str, list[str]]] = {kind: {} for kind in _KINDS}

    def add(self, kind: str, what: str, name: str = "") -> None:
        """Note `what` happened, to the element `name`; notes of one `what` become one line."""
        names = self.found[kind].setdefault(what, [])
        if name and name not in names:
            names.append(name)

    def lines(self, most: int = 4) -> list[str]:
        """The report as lines of text, with at most `most` names in each."""
        lines = []
        for kind, found in self.found.items():
            for what, names in found.items():
                shown = ", ".join(" ".join(name.splitlines()) for name in names[:most])
                more = f" and {len(names) - most} more" if len(names) > most else ""
                lines.append(f"{kind}: {what}" + (f": {shown}{more}" if names else ""))
        return lines
