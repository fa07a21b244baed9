"""What the tests share: the flag that renews golden files, and how examples of property tests are chosen."""

import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

from output.ebb.control import signals_as_they_were

# The same examples in every run, so that a change is judged by itself; the long loops look for new ones each time.
settings.register_profile("same", derandomize=True)
settings.register_profile("new", derandomize=False)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--renew-golden", action="store_true", help="write the golden command files anew instead of comparing")


def pytest_configure(config: pytest.Config) -> None:
    # Under nohup, or started with `&`, the program rightly ignores them, and its tests would fail.
    for name in ("SIGHUP", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    settings.load_profile("same" if config.getoption("markexpr") == "not long" else "new")


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    """A plot ends with its signals ignored, for the message's sake; the next test is not to inherit that."""
    with signals_as_they_were():
        yield
