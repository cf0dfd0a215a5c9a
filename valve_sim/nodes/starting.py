"""Starting and ending a node: parameter files read first, errors in one line, exit codes, signals."""

from __future__ import annotations

import contextlib
import faulthandler
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
from collections.abc import Callable, MutableMapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn

from valve_sim.files.parameter_files import valve_from_flat
from valve_sim.files.parameter_sections import Section, read_sections
from valve_sim.files.resources import config_path
from valve_sim.invocation import invocation
from valve_sim.model.errors import ParameterError, ValveError

if TYPE_CHECKING:
    from valve_sim.nodes.wiring import RosNode

UNUSABLE_INPUT: Final = 2
"""Exit code after one line on stderr."""
STOP_SECONDS: Final = 0.3
"""s that each thread of a node may take to end; one that calculates for longer is ended with the process."""
END_SECONDS: Final = 1.5
"""s after a signal at which a node is ended, whatever it does."""
LAST_SECONDS: Final = 10.0
"""s after a signal at which a node is ended that hangs in a library's compiled code, where no thread of Python runs."""
_PARAMETER_FLAG: Final = "--params-file"
_CODE: Final = "    "
"""Indentation of the commands in a usage."""


GivenFiles = list[tuple[str, Section]]
"""The sections of the parameter files on a command line: (file as given, section), in order."""


class Extra(NamedTuple):
    """A library that an extra of this package brings: its module, the extra's name, and what it is needed for."""

    module: str
    name: str
    purpose: str

    def require(self) -> None:
        """Import the library.

        Raises:
            ValveError: it is not installed, or cannot be imported; one line that says what to install.
        """
        try:
            importlib.import_module(self.module)
        except ImportError as error:
            raise ValveError(
                f"{self.purpose} needs {self.module}, which cannot be imported ({error}); pip install '.[{self.name}]' "
                "in a checkout"
            ) from error


class Program(NamedTuple):
    """A program that runs one node, as `ros2 run` calls it.

    Attributes:
        name: of the program.
        place: "module:Class" of its node, which is imported only after ROS was found; without it one line is printed.
        about: what it does, with a command that works as printed; lines that begin with four spaces and the program's
            name are commands.
        pages: where to read on. codes: its exit codes.
        needs: a library that not everyone has; None where ROS is enough.
    """

    name: str
    place: str
    about: str
    pages: str
    codes: str = "0 after Ctrl-C or SIGTERM, 1 after a failure, 2 for unusable input"
    needs: Extra | None = None

    def __call__(self, args: Sequence[str] | None = None) -> int:
        """Start the node, spin it, and return its exit code.

        Args:
            args: the command line with the program's own name first; default sys.argv.

        Returns:
            0 after --help, SIGINT or SIGTERM, 1 if the node failed, 2 after one line on stderr about unusable input.
        """
        arguments = list(sys.argv if args is None else args)
        if _asks_for_help(arguments):
            print(_as_typed(self.name, self.usage))
            return 0
        signals = _Signals()
        try:
            given = read_files(arguments)
            _ensure_log_folder(self.name)
            offer_profile(os.environ, Path.cwd(), installed_rclpy())
            rclpy_init(arguments)
            node = None if signals.have_come else _made(self.place, given, self.needs)
        except ValveError as error:
            print(f"{self.name}: {error}", file=sys.stderr)
            return UNUSABLE_INPUT
        if node is None:
            rclpy().try_shutdown()
            return 0
        signals.node = node
        return _spin(self.name, node)

    @property
    def usage(self) -> str:
        """What --help prints."""
        return f"""{self.about}
    Parameters are set by -p name:=value after --ros-args, or by --params-file. They are
    listed in docs/reference, and `ros2 param describe` explains those of a running node.

    Exit code {self.codes}.

    Read on: {self.pages}
"""


def chosen(*programs: Program) -> int:
    """Run the program that the command line names first, with the rest of it; its exit code."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    for program in programs:
        if program.name == name:
            return program(sys.argv[1:])
    names = ", ".join(program.name for program in programs)
    print(f"expected one of {names} first, found {name or 'nothing'}", file=sys.stderr)
    return UNUSABLE_INPUT


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


def _made(place: str, given: GivenFiles, needs: Extra | None) -> RosNode[Any] | None:
    """The node; None if a signal ended ROS meanwhile."""
    module, _, kind = place.partition(":")
    try:
        if needs is not None:
            needs.require()
        made: RosNode[Any] = getattr(importlib.import_module(module), kind)(given)
        return made
    except ValveError:
        rclpy().try_shutdown()
        raise
    except Exception:
        if rclpy().ok():
            raise
        return None


def _spin(name: str, node: RosNode[Any]) -> int:
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
    because it reads a long recording or answers a question that takes long, is ended there. One that hangs in compiled
    code, as rclpy once did while it destroyed a node, is ended by `LAST_SECONDS` with code 1; stderr has where it hung.
    """

    def __init__(self) -> None:
        self.have_come = False
        self.node: RosNode[Any] | None = None
        _on_signals(self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.have_come:
            return
        self.have_come = True
        latest = threading.Timer(END_SECONDS, self._end)
        latest.daemon = True
        latest.start()
        with contextlib.suppress(OSError, ValueError, AttributeError):  # without stderr there is no such guard
            faulthandler.dump_traceback_later(LAST_SECONDS, exit=True)

    def _end(self) -> None:
        _end_at_once(0 if self.node is None else self.node.exit_code)


def _on_signals(action: signal.Handlers | Callable[[int, FrameType | None], None]) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, action)


def _ensure_log_folder(name: str) -> None:
    """Log elsewhere, and say so, where ROS cannot write its log: it would not start."""
    rclpy()
    folder = Path(importlib.import_module("rclpy.logging").get_logging_directory())
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


class Profile(NamedTuple):
    """A file of ours and the environment variable by which Fast DDS finds it."""

    variable: str
    file: str


FAST_DDS_2: Final = Profile("FASTRTPS_DEFAULT_PROFILES_FILE", "fast_dds_2.xml")
FAST_DDS_3: Final = Profile("FASTDDS_DEFAULT_PROFILES_FILE", "fast_dds_3.xml")
OWN_FILES: Final = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
"""File that Fast DDS reads from the folder in which a process starts."""
RCLPY_WITH_FAST_DDS_3: Final = 9
"""The major version of rclpy in Kilted, the first ROS 2 with Fast DDS 3; Jazzy has 7 and Fast DDS 2.14."""


def profile_of(rclpy: str) -> Profile:
    """Which of our profiles the Fast DDS of a ROS 2 understands.

    Fast DDS 3 reads the variable of version 2, too, and complains of what it finds there: a process is given one only.

    Args:
        rclpy: version of that ROS 2's rclpy, such as 7.1.5.
    """
    return FAST_DDS_3 if int(rclpy.partition(".")[0]) >= RCLPY_WITH_FAST_DDS_3 else FAST_DDS_2


def installed_rclpy() -> str | None:
    """Version of the rclpy on the path, or None if it does not say."""
    try:
        return version("rclpy")
    except PackageNotFoundError:
        return None


def offer_profile(environment: MutableMapping[str, str], folder: Path, rclpy: str | None) -> None:
    """Have Fast DDS note acknowledgements every 4 ms, and announce itself for 3 s; to be called before ROS starts.

    After each message Fast DDS wakes a thread of its own, only to note that a reader may now ask for that message
    again: 2 to 5 % of a core at 1 kHz. A reader does not ask sooner than 5 ms after the writer's heartbeat, so our
    profiles have it noted every 4 ms. And it announces itself five times to a process that begins, which may hear none
    of them while it starts, and then every 3 s: our profiles have it announce itself every 0.1 s until then, so that a
    process that begins is found within half a second, not after 3 s. Other middleware does not read these variables.

    Args:
        environment: of this process; changed, unless it names profiles of the user's own.
        folder: in which the process starts; a file of profiles there counts too.
        rclpy: see `installed_rclpy`; nothing is offered where it is not known.
    """
    named = any(profile.variable in environment for profile in (FAST_DDS_2, FAST_DDS_3))
    if rclpy is None or named or any((folder / name).exists() for name in OWN_FILES):
        return
    profile = profile_of(rclpy)
    environment[profile.variable] = str(config_path(profile.file))
