"""Help under headings: what people reach for first comes first, and what few need is shown by `--help-all` only."""

from __future__ import annotations

from enum import Enum
from itertools import groupby
from typing import Any

import click

_COLUMN = 30


class Heading(Enum):
    """What an option is for, in the order of the help; those of `EXPERT` are shown by `--help-all`."""

    OWN = "Options"
    MACHINE = "Machine and quality"
    PAGE = "Where the drawing lies"
    SPEED = "Speed and accuracy"
    PEN = "Pen"
    INK = "Ink"
    ORDER = "Order"
    READING = "Reading the drawing"
    FINER_SPEED = "Acceleration and jerk"
    FINER_PEN = "Pen, in detail"
    FINER_ORDER = "Order and strokes, in detail"
    BOARD = "Board commands"
    LIMITS = "Limits on the drawing's size"


EXPERT = frozenset({Heading.FINER_SPEED, Heading.FINER_PEN, Heading.FINER_ORDER, Heading.BOARD, Heading.LIMITS})


class HeadedOption(click.Option):
    """An option with its heading."""

    def __init__(self, *args: Any, heading: Heading, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.heading = heading


class HeadedCommand(click.Command):
    """A command whose options have headings; those without one are its own."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """With `--help-all` before click's own `--help`, which is the last."""
        *others, usual = super().get_params(ctx)
        return [*others, self._help_all(), usual]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The options' part of the help."""
        options = [option for option in self.get_params(ctx) if isinstance(option, click.Option)]
        order = list(Heading)
        everything = ctx.meta.get(__name__, False)
        hidden = []
        for heading, group in groupby(sorted(options, key=lambda option: order.index(_heading(option))), key=_heading):
            rows = [record for option in group if (record := option.get_help_record(ctx)) is not None]
            if heading in EXPERT and not everything:
                hidden.append((heading, len(rows)))
                continue
            with formatter.section(heading.value):
                # As wide in every section, so that the texts begin below each other.
                formatter.write_dl([(f"{flag:{_COLUMN}}", text) for flag, text in rows], col_max=_COLUMN)
        if hidden:
            count = sum(number for _, number in hidden)
            titles = ", ".join(heading.value.replace(",", "").lower() for heading, _ in hidden)
            formatter.write_paragraph()
            formatter.write_text(f"{count} more options with --help-all: {titles}.")

    def _help_all(self) -> click.Option:
        return click.Option(
            ["--help-all"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_show_all,
            help="Show this message with every option, and exit.",
        )


def _show_all(ctx: click.Context, _param: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        ctx.meta[__name__] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


def _heading(option: click.Option) -> Heading:
    return option.heading if isinstance(option, HeadedOption) else Heading.OWN
