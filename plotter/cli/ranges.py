"""Numbers within bounds, as options take them."""

from __future__ import annotations

import math
from typing import Any

import click


class NumberRange(click.FloatRange):
    """A range in which NaN does not lie, which compares as within every bound."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{number} is no number: give one from {self.min:g} to {self.max:g}", param, ctx)
        return number
