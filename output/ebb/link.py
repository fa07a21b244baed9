"""The port: three verbs under the protocol core, and a way to wake whoever waits in `receive`.

All that a port can throw becomes `LinkLost` here, once: pyserial raises SerialException, a vanished device a bare OSError, and
some calls `termios.error`, which is not an OSError. The stream never flushes or drains: on several systems that blocks for ever
once the device is gone.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import selectors
import threading
from typing import Any, Protocol

import serial

from output.ebb.commands_text import with_checksum
from output.ebb.port_lock import PortLock
from output.errors import BoardRefused, LinkLost

try:
    import fcntl
    import termios
except ImportError:  # Windows: pyserial opens its ports exclusively there
    fcntl = None  # type: ignore[assignment]
    termios = None  # type: ignore[assignment]

_PORT_ERRORS: tuple[type[Exception], ...] = (serial.SerialException, OSError)
if termios is not None:
    _PORT_ERRORS = (*_PORT_ERRORS, termios.error)

# A board that takes no bytes for this long has hung; bytes that we leave unanswered are few, so a healthy one never does.
WRITE_TIMEOUT_S = 0.4
CLOSE_TIMEOUT_S = 1.0
_POLL_WITHOUT_SELECT_S = 0.005


class Port(Protocol):
    """What the session needs of a port. `wake` may be called from a signal handler or from another thread."""

    name: str

    def send(self, data: bytes) -> None:
        """Writes all of `data`. Raises LinkLost when the port is gone or takes nothing for WRITE_TIMEOUT_S."""

    def receive(self, timeout_s: float) -> bytes:
        """What has come in; waits at most `timeout_s`, and returns b"" early when woken. Raises LinkLost."""

    def wake(self) -> None:
        """Makes a `receive` that waits, or the next one, return at once."""

    def close(self) -> None:
        """Gives the port back. Never raises and never takes longer than CLOSE_TIMEOUT_S."""


class SerialPort:
    """A port of pyserial, taken for ourselves: flock (other programs of this kind) and TIOCEXCL (everyone but root).

    Raises LinkLost when there is no such port and BoardRefused when it may not be opened, with the cure for each cause.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._lock = PortLock(name)
        try:
            self._serial = _open(name)
        except BaseException:
            self._lock.release()
            raise
        self._fd = _descriptor(self._serial)
        self._closed = False
        if self._fd is not None:
            self._wake_read, self._wake_write = os.pipe()
            os.set_blocking(self._wake_read, False)
            os.set_blocking(self._wake_write, False)
            self._selector = selectors.DefaultSelector()
            self._selector.register(self._fd, selectors.EVENT_READ)
            self._selector.register(self._wake_read, selectors.EVENT_READ)

    def send(self, data: bytes) -> None:
        try:
            if self._fd is None:
                self._serial.write(data)
            else:
                self._write(self._fd, data)
        except serial.SerialTimeoutException as error:
            raise LinkLost(
                f"{self.name} took no bytes for {WRITE_TIMEOUT_S} s: the board hangs or its cable is bad; plug it in again"
            ) from error
        except _PORT_ERRORS as error:
            raise self._lost(error) from error

    @staticmethod
    def _write(fd: int, data: bytes) -> None:
        """As pyserial's, which takes a write for late when the process was stopped (SIGSTOP) in the middle of it."""
        while data:
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(fd, data) :]
            # A wait that outlasted its time because the process was stopped has not looked: it is done again without waiting.
            if data and not (_writable(fd, WRITE_TIMEOUT_S) or _writable(fd, 0.0)):
                raise serial.SerialTimeoutException

    def receive(self, timeout_s: float) -> bytes:
        try:
            if self._fd is None:
                return self._receive_polling(timeout_s)
            for key, _ in self._selector.select(max(0.0, timeout_s)):
                if key.fd == self._wake_read:
                    with contextlib.suppress(BlockingIOError):
                        os.read(self._wake_read, 4096)
                    continue
                data = os.read(self._fd, 4096)
                if not data:
                    raise OSError(errno.ENODEV, "the device reports end of file")
                return data
            return b""
        except BlockingIOError:
            return b""
        except _PORT_ERRORS as error:
            raise self._lost(error) from error

    def wake(self) -> None:
        if self._fd is not None and not self._closed:
            # A full pipe wakes as well; and a thread may still call this while the port is being closed.
            with contextlib.suppress(OSError):
                os.write(self._wake_write, b"w")

    def close(self) -> None:
        """A close may wait in the kernel for bytes that will never leave, so it gets its own thread and a deadline."""
        if self._closed:
            return
        self._closed = True
        closer = threading.Thread(target=self._close_quietly, daemon=True, name="close-port")
        closer.start()
        closer.join(CLOSE_TIMEOUT_S)
        self._lock.release()
        if self._fd is not None:
            self._selector.close()
            os.close(self._wake_read)
            os.close(self._wake_write)

    def _close_quietly(self) -> None:
        with contextlib.suppress(*_PORT_ERRORS):
            self._serial.close()

    def _receive_polling(self, timeout_s: float) -> bytes:
        """Where a port has no file descriptor (Windows): the least timeout that reacts to a stop in time."""
        self._serial.timeout = min(max(timeout_s, 0.0), _POLL_WITHOUT_SELECT_S)
        return bytes(self._serial.read(max(1, self._serial.in_waiting)))

    def _lost(self, error: BaseException) -> LinkLost:
        return LinkLost(f"the link to {self.name} is lost ({_reason(error)}): check the USB cable and the board's power")


def _descriptor(port: Any) -> int | None:
    """By which the port can be waited for; None where it has none (Windows, whose class inherits a `fileno` that raises)."""
    try:
        return int(port.fileno())
    except (AttributeError, io.UnsupportedOperation):
        return None


def _writable(fd: int, timeout_s: float) -> bool:
    return bool(select.select([], [fd], [], timeout_s)[1])


def _open(name: str) -> Any:
    try:
        port = serial.Serial()
        port.port, port.timeout, port.write_timeout = name, 0, WRITE_TIMEOUT_S
        port.exclusive = True if os.name == "posix" else None
        port.open()
        if fcntl is not None:
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        return port
    except _PORT_ERRORS as error:
        if _is_missing(error):
            raise LinkLost(f"there is no port {name}: plug the board in, and see `plotter ports` for what is there") from error
        raise BoardRefused(_advice(name, error)) from error
    except ValueError as error:
        raise BoardRefused(f"{name!r} is not the name of a port ({error}): `plotter ports` lists them") from error


def _is_missing(error: BaseException) -> bool:
    missing = (errno.ENOENT, errno.ENXIO, errno.ENODEV)
    return getattr(error, "errno", None) in missing or "FileNotFoundError" in str(error)


def _advice(name: str, error: BaseException) -> str:
    """One sentence a cause. pyserial keeps the errno of a failed open, and reports a held lock as EWOULDBLOCK in its text."""
    number = getattr(error, "errno", None)
    text = str(error)
    if number in (errno.EACCES, errno.EPERM) or "PermissionError" in text:
        return (
            f"no permission to open {name}: add yourself to the group that owns it (`sudo usermod -aG dialout $USER`, or uucp) "
            "and log in again"
        )
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text:
        return f"{name} is in use by another program: end that one first"
    if number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL) or "Could not configure" in text:
        return f"{name} is not a serial port: `plotter ports` lists those that are"
    return f"{name} cannot be opened ({_reason(error)}): unplug the board, plug it in, and try again"


def _reason(error: BaseException) -> str:
    return (str(error) or type(error).__name__).strip().rstrip(".")[:120]


class ChecksummedPort:
    """A port to a board that wants a checksum behind every command (CU,54,1): noise in the cable is refused, not obeyed."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.name = port.name

    def send(self, data: bytes) -> None:
        lines = data.decode("ascii").split("\r")
        self._port.send("\r".join(with_checksum(line) if line else line for line in lines).encode("ascii"))

    def receive(self, timeout_s: float) -> bytes:
        return self._port.receive(timeout_s)

    def wake(self) -> None:
        self._port.wake()

    def close(self) -> None:
        """Leaves the board as other programs expect it."""
        with contextlib.suppress(LinkLost):
            self.send(b"CU,54,0\r")
        self._port.close()
