"""The journal of a plot: where it is kept, what its head says of the drawing, and the job made again from that head."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from datetime import datetime
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from pydantic import ValidationError

from output.ebb.commands import Command
from output.ebb.encode import BoardSetup, encode, epilogue, prologue
from output.ebb.journal import PlotState, differences, load
from output.ebb.program import Mark
from output.ebb.resume import Place
from output.wording import counted
from planning.geometry.remainder import OVERLAP_MM, remainder
from planning.geometry.stroke import Layer
from planning.motion.plan import Action, Draw, Lower
from plotter.board_setup import HOME_MM
from plotter.errors import BadInput
from plotter.machines.profile import Machine, first_fault, load_machine
from plotter.pipeline import Job, planned, planned_from, prepare
from plotter.settings import Settings
from plotter.svg.options import Budgets, ReadOptions


def journal_path() -> Path:
    """Where the journal of the latest plot is kept. One plot at a time is journalled; a new one takes the place of the last."""
    return platformdirs.user_state_path("plotter") / "plot.journal"


def head(job: Job, file: str, reading: ReadOptions) -> dict[str, Any]:
    """What must be the same for a plot to be resumed, and what making it again needs."""
    return {
        "file": str(Path(file).resolve()) if file != "-" else "-",
        "drawing": job.digest,
        "program_version": version("plotter"),
        "machine": _facts(job.machine),
        "strokes": job.drawing.stroke_count,
        "start_mm": job.start_mm.tolist(),
        "settings": job.settings.model_dump(),
        "reading": asdict(reading),
    }


def interrupted_plot() -> PlotState:
    """The journal of the plot to be resumed. Raises BadInput when there is none, or none that this version can go on with."""
    path = journal_path()
    state = load(path)
    if state is None:
        if (unreadable := _unreadable(path)) is not None:
            raise BadInput(
                f"the journal {path} cannot be read ({unreadable}): nothing can be resumed, so plot the drawing anew"
            )
        raise BadInput("there is no interrupted plot to resume: start one with `plotter plot`")
    if not state.interrupted:
        raise BadInput(f"the last plot ({state.head.get('file')}) was finished: there is nothing to resume")
    if state.head.get("file") == "-":
        raise BadInput("the interrupted plot was read from standard input, which is gone: save the drawing and plot it anew")
    then, now = state.head.get("program_version"), version("plotter")
    if then != now:  # before anything else of it is read, which may be no longer understood
        raise _not_resumable(state, f"program version was {then}, is {now}")
    return state


def _unreadable(path: Path) -> str | None:
    """Why the journal there, of which nothing could be read, tells nothing; None when there is none."""
    try:
        empty = not path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        return error.strerror or str(error)
    return "it is empty, since there was no room for it" if empty else "its head is damaged, or of another version"


def _not_resumable(state: PlotState, why: str) -> BadInput:
    return BadInput(f"the interrupted plot cannot be resumed, because {why}; plot {state.head.get('file')} anew")


def given_up() -> str | None:
    """The interrupted plot that a new one puts an end to, in a clause; None when there is none that could be resumed."""
    state = load(journal_path())
    if state is None or not state.interrupted or state.head.get("file") == "-":
        return None
    began = datetime.fromtimestamp(state.began_s).strftime("%Y-%m-%d %H:%M") if state.began_s else "some time ago"
    drawn = f"interrupted after {counted(len(state.strokes_done), 'stroke')}"
    return f"the plot of {state.head.get('file')}, begun {began}, was {drawn}"


def made_again(state: PlotState) -> Job:
    """The job that the journal is of, from the same file and settings. Raises BadInput naming what is not as it was."""
    options, settings, file = _reading_of(state), settings_of(state), str(state.head["file"])
    # Before the drawing is read: it may no longer fit on what the machine is now.
    for changed in differences({"machine": state.head.get("machine")}, {"machine": _facts(load_machine(settings.machine))}):
        raise _not_resumable(state, changed)
    start_mm = np.array(state.head.get("start_mm", HOME_MM), dtype=np.float64)
    job = prepare(file, options, settings, start_mm)
    for changed in differences(state.head, head(job, file, options)):
        raise _not_resumable(state, changed)
    return job


def _facts(machine: Machine) -> dict[str, Any]:
    """What a machine's own profile says; settings know its name only."""
    return machine.model_dump(mode="json")


def settings_of(state: PlotState) -> Settings:
    """The settings that the plot was begun with. Raises BadInput, naming the first, when they are not settings any more."""
    try:
        return Settings.model_validate(state.head.get("settings"))
    except ValidationError as error:
        raise _not_resumable(state, f"its settings are not this version's: {first_fault(error)}") from None


def _reading_of(state: PlotState) -> ReadOptions:
    reading = dict(state.head.get("reading", {}))
    budgets = dict(reading.pop("budgets", {}))
    known = {field.name for kind in (ReadOptions, Budgets) for field in fields(kind)}
    if unknown := sorted({*reading, *budgets} - known):
        raise _not_resumable(state, f"its reading is not this version's: there is no option '{unknown[0]}'")
    return ReadOptions(**reading, budgets=Budgets(**budgets))


@dataclass(frozen=True, slots=True)
class Part:
    """A resumed part of a plot: it begins with stroke number `stroke`, `drawn_mm` of which are drawn, up to `left_mm` (2,).

    The carriage stands at `start_mm` (2,); `homed` says that the board's counters were lost and start again at home. All in
    machine millimetres. `pause_over` says that a pause of the drawing's own before that stroke has been made. The same facts
    make the same program, so that a resumed plot can be resumed again.
    """

    stroke: int
    drawn_mm: float
    left_mm: tuple[float, float]
    start_mm: tuple[float, float]
    homed: bool
    pause_over: bool = False

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Part | None:
        """From a journal's record; None for the first part, which is the whole plot."""
        if "stroke" not in facts:
            return None
        left, start = (tuple(map(float, facts[name])) for name in ("left_mm", "start_mm"))
        homed, pause_over = bool(facts["homed"]), bool(facts.get("pause_over", False))
        return cls(int(facts["stroke"]), float(facts["drawn_mm"]), (left[0], left[1]), (start[0], start[1]), homed, pause_over)


def part_program(job: Job, setup: BoardSetup, part: Part | None) -> Iterator[Command | Mark]:
    """The whole program of a part; None is the first one. The same facts make the same program."""
    yield from part_beginning(setup, part)
    yield from encode(part_actions(job, part), setup)
    yield from epilogue(setup)


def part_beginning(setup: BoardSetup, part: Part | None) -> Iterator[Command | Mark]:
    """The board's set-up; on a resumed part the counters go on from where the board stands."""
    return prologue(setup, keep_counters=part is not None and not part.homed)


def part_actions(job: Job, part: Part | None) -> Iterator[Action]:
    """The Plan of a part. Strokes keep the numbers that they have in the whole plot."""
    if part is None:
        return planned(job)
    return _rest(job, part)


def _rest(job: Job, part: Part) -> Iterator[Action]:
    """Nothing is looked for before the first action is asked for: the order may still be being found."""
    pieces, first = layers_left(job.ordering, part)
    yield from _numbered_from(first, planned_from(job, pieces, np.array(part.start_mm)))


def part_after(setup: BoardSetup, before: Part | None, place: Place, homed: bool = False, *, pause_over: bool = False) -> Part:
    """What is left to draw when part `before` has come as far as `place`, and the pen is there, or at home when `homed`."""
    same = before if before is not None and before.stroke == place.next_stroke else None
    pause_over = pause_over or (same is not None and same.pause_over)
    scale = float(np.sqrt(abs(np.linalg.det(setup.kinematics.steps_per_mm))))
    drawn_mm = place.drawn_steps / scale if place.stroke is not None else 0.0
    left_mm = position_mm(setup, place.steps)
    start_mm = (0.0, 0.0) if homed else left_mm
    if same is not None and same.drawn_mm:
        if not drawn_mm:
            return replace(same, start_mm=start_mm, homed=homed)
        drawn_mm += max(same.drawn_mm - OVERLAP_MM, 0.0)
    return Part(place.next_stroke, drawn_mm, left_mm, start_mm, homed, pause_over)


def position_mm(setup: BoardSetup, steps: tuple[int, int]) -> tuple[float, float]:
    """Where the pen is when the motors' counters are `steps`, in machine millimetres."""
    x, y = setup.kinematics.millimetres(np.array([steps], dtype=float))[0] + setup.origin_mm
    return float(x), float(y)


def layers_left(layers: Iterable[Layer], part: Part) -> tuple[Iterator[Layer], int]:
    """The layers, or pieces of them, without what is drawn, and the number of their first stroke in the whole plot.

    Looks no further than to the part's first stroke; what comes after it is passed on as it comes.
    """
    rest = iter(layers)
    before = 0
    for layer in rest:
        count = len(layer.strokes)
        if part.stroke >= before + count:
            before += count
            continue
        strokes = list(layer.strokes[part.stroke - before :])
        first, begun = part.stroke, before < part.stroke
        if part.drawn_mm > 0:
            left = remainder(strokes[0], part.drawn_mm, np.array(part.left_mm))
            strokes[:1] = [] if left is None else [left]
            first, begun = part.stroke + (left is None), True
        begun = begun or part.pause_over
        here = replace(layer, strokes=tuple(strokes), pause_before=layer.pause_before and not begun)
        return chain([here] if strokes else [], rest), first
    return iter(()), part.stroke


def _numbered_from(first: int, actions: Iterator[Action]) -> Iterator[Action]:
    for action in actions:
        if isinstance(action, Draw | Lower):
            yield replace(action, stroke=action.stroke + first)
        else:
            yield action
