"""What the reader left out, counted: each kind of note becomes one sentence."""

from __future__ import annotations

from output.wording import agreeing
from plotter.svg.names import in_one_line

_MOST_NAMES = 3


class Notes:
    """Collects notes while reading. A template may hold `{count}`, `{names}` and `[is|are]` (`agreeing`); each is said once."""

    def __init__(self) -> None:
        self._count: dict[str, int] = {}
        self._names: dict[str, list[str]] = {}

    def add(self, template: str, name: str | None = None, count: int = 1) -> None:
        self._count[template] = self._count.get(template, 0) + count
        names = self._names.setdefault(template, [])
        if name and len(names) <= _MOST_NAMES and name not in names:
            names.append(name)

    def sentences(self) -> tuple[str, ...]:
        return tuple(self._sentence(template) for template in self._count)

    def _sentence(self, template: str) -> str:
        names = self._names[template]
        shown = ", ".join(names[:_MOST_NAMES]) + (", ..." if len(names) > _MOST_NAMES else "")
        count = self._count[template]
        sentence = agreeing(template, count).replace("{count}", str(count)).replace("{names}", shown)
        return in_one_line(sentence)  # names of elements, fonts and references come as the file has them
