"""The queue model against cases that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from output.ebb.firmware import firmware
from output.ebb.queue_forecast import QueueForecast, QueueSetup, queue_setup, service_s


def feed(
    depth: int, takes_ms: list[float], lasts_ms: list[float], moving: list[bool] | None = None
) -> tuple[list[float], QueueForecast]:
    model = QueueForecast(QueueSetup(depth, 0.0))
    speed = np.where(moving if moving is not None else [True] * len(lasts_ms), 10.0, 0.0)
    leads = model.feed(np.arange(len(lasts_ms)), np.array(takes_ms) / 1000, np.array(lasts_ms) / 1000, speed)
    return [round(lead * 1000, 6) for lead in leads], model


def test_depth_one_has_the_command_before_as_its_lead() -> None:
    leads, model = feed(1, [2] * 5, [10] * 5, [False, True, True, True, True])
    # Command 1 comes 2 ms after 0 started; from then on each is queued when the one before it starts.
    assert leads == [-2, 8, 10, 10, 10]
    assert (model.underruns, model.lowest_at) == (0, 2) and model.lowest_lead_s == pytest.approx(0.010)


def test_the_lowest_lead_is_that_of_a_queue_that_has_been_full() -> None:
    _, filling = feed(4, [2] * 4, [10] * 4)
    assert not filling.has_been_full and filling.lowest_lead_s == pytest.approx(-0.002)
    leads, full = feed(4, [2] * 13, [10] * 9 + [4] * 4)
    assert full.has_been_full and full.lowest_lead_s == pytest.approx(min(leads[5:]) / 1000) == pytest.approx(0.022)
    assert full.lowest_at == 12 and full.underruns == 1


def test_a_deep_queue_fills_up() -> None:
    leads, _ = feed(4, [2] * 12, [10] * 12)
    assert leads[1:5] == [8, 16, 24, 32] and leads[-1] == 40


def test_commands_shorter_than_they_take_run_dry() -> None:
    leads, model = feed(4, [5] * 20, [3] * 20, [False] + [True] * 19)
    assert leads[1] == -2 and model.underruns == 19 and model.starved_s == pytest.approx(19 * 0.002)
    assert model.first_underruns[0] == (1, pytest.approx(0.002)) and len(model.first_underruns) == 5


def test_a_wait_before_them_lets_short_commands_through() -> None:
    assert feed(30, [1] + [5] * 20, [200] + [3] * 20, [False] * 2 + [True] * 19)[1].underruns == 0
    assert feed(1, [1] + [5] * 20, [200] + [3] * 20, [False] * 2 + [True] * 19)[1].underruns > 0


def test_running_dry_at_rest_is_no_underrun() -> None:
    assert feed(2, [50] * 5, [1] * 5, [False] * 5)[1].underruns == 0


def test_it_goes_on_from_call_to_call() -> None:
    whole, _ = feed(3, [2, 3, 4, 5, 6, 7], [5, 1, 9, 2, 8, 3])
    model = QueueForecast(QueueSetup(3, 0.0))
    parts = [
        model.feed(np.array([i]), np.array([takes / 1000]), np.array([lasts / 1000]), np.array([10.0]))[0]
        for i, (takes, lasts) in enumerate(zip([2, 3, 4, 5, 6, 7], [5, 1, 9, 2, 8, 3], strict=True))
    ]
    assert [round(lead * 1000, 6) for lead in parts] == whole


def test_service_times_grow_with_the_load_between_the_two_measured() -> None:
    board = firmware("3.0.3")
    idle, half, full, more = service_s(board, "T3", np.array([0.0, 0.5, 1.0, 2.0]))
    assert (idle, full) == (0.0027, 0.0037) and idle < half < full == more
    assert service_s(board, "QG", np.zeros(1))[0] == board.service_ms["other"][0] / 1000
    assert queue_setup(board).depth == 30 and queue_setup(firmware("2.8.1")).depth == 1
