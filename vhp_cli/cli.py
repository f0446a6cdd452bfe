"""The front door: the group of commands, and how every error turns into words and an exit code.

Nothing but click is imported here, and a command's module only when that command runs.
"""

from __future__ import annotations

import difflib
import errno
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import click

from vhp_cli import __version__
from vhp_cli.errors import NoRoomError, UnreadableFileError, VhpError

# Exit codes beyond 0 (passed) and 1 (the gate found errors), which the commands return.
USAGE = 2
FAILED = 3
INTERRUPTED = 130
PIPE_CLOSED = 141

VERSIONED = ("numpy", "click", "rich", "trimesh", "manifold3d", "pymeshlab", "pytetwild")


class Entry(NamedTuple):
    """Where a command is, and the line that ``vhp --help`` shows for it."""

    target: str
    summary: str


COMMANDS = {
    "breathe": Entry("vhp_cli.commands.breathe:breathe", "Make a model breathe, with proof for every frame."),
    "check": Entry("vhp_cli.commands.check:check", "Check a model; exit 1 if it is not fit for a solver."),
    "decimate": Entry("vhp_cli.commands.decimate:decimate", "Reduce the triangles of a model, or refine the worst."),
    "diff": Entry("vhp_cli.commands.diff:diff", "Compare two models or reports; exit 1 if the second is worse."),
    "export": Entry("vhp_cli.commands.export:export", "Write a model for HFSS, CST, MATLAB, COMSOL or a printer."),
    "heal": Entry("vhp_cli.commands.heal:heal", "Close, orient and repair the tissues of a model."),
    "phantom": Entry("vhp_cli.commands.phantom:phantom", "Write a synthetic model, sound or with known defects."),
    "rules": Entry("vhp_cli.commands.rules:rules", "List the rules, or explain one."),
    "run": Entry("vhp_cli.commands.run:run", "Run a pipeline of commands, or a preset, and resume it."),
    "separate": Entry("vhp_cli.commands.separate:separate", "Take crossing tissues apart, with a gap between them."),
    "shells": Entry("vhp_cli.commands.shells:shells", "Make skin, fat and average body from one body surface."),
    "smooth": Entry("vhp_cli.commands.smooth:smooth", "Improve the triangles of a model and keep its shape."),
    "tetmesh": Entry("vhp_cli.commands.tetmesh:tetmesh", "Fill a model with labelled tetrahedra."),
    "view": Entry("vhp_cli.commands.view:view", "Show a model and its findings in a browser."),
}


class PipeClosed(Exception):
    """Whoever read the output went away, as `head` does."""


class LazyGroup(click.Group):
    """A group that knows its commands from `COMMANDS` and imports one when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the command names."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        entry = COMMANDS.get(cmd_name)
        if entry is None:
            return None
        module, _, attribute = entry.target.partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the command section of the help without importing any command."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name].summary) for name in self.list_commands(ctx)])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; name the nearest one for a misspelt name."""
        name = args[0]
        if name not in COMMANDS and not name.startswith("-") and not ctx.resilient_parsing:
            near = difflib.get_close_matches(name, COMMANDS, n=1)
            ctx.fail(f"no such command '{name}'." + (f" Did you mean '{near[0]}'?" if near else ""))
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; a closed pipe, which click and rich turn into exit code 1, stays what it is."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            raise PipeClosed from error
        except SystemExit as error:
            if isinstance(error.__context__, BrokenPipeError):
                raise PipeClosed from error
            raise


def _show_version(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    if not value or ctx.resilient_parsing:
        return
    import platform
    from importlib import metadata

    click.echo(f"vhp {__version__}")
    click.echo(f"Python {platform.python_version()} ({sys.platform}, {platform.machine()})")
    for name in VERSIONED:
        try:
            click.echo(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            click.echo(f"{name} not installed")
    ctx.exit()


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 passed, 1 errors found, 2 wrong usage or nothing readable, 3 a tissue could not be "
    "processed, 130 interrupted.",
)
@click.option("-q", "--quiet", is_flag=True, help="No progress and no notes on stderr.")
@click.option("-v", "--verbose", is_flag=True, help="More on stderr; a traceback with an internal error.")
@click.option("--no-color", is_flag=True, help="No colour, as with the environment variable NO_COLOR.")
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_version,
    help="Show the versions of vhp and its libraries, and exit.",
)
@click.pass_context
def cli(ctx: click.Context, quiet: bool, verbose: bool, no_color: bool) -> None:
    """Check and heal models made of tissue surface meshes before they go into a FEM or EM solver."""
    if quiet and verbose:
        raise click.UsageError("--quiet and --verbose exclude each other.")
    if no_color:
        # rich and click read it wherever they are used, child processes included.
        os.environ["NO_COLOR"] = "1"
        os.environ.pop("FORCE_COLOR", None)
        ctx.color = False
    settings = ctx.ensure_object(dict)
    settings["quiet"] = quiet
    settings["verbose"] = verbose


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``vhp`` and return its exit code.

    Parameters
    ----------
    arguments
        Command line without the program's name; that of the process if None.

    Returns
    -------
    int
        0 passed, 1 the gate found errors, 2 wrong usage or nothing readable, 3 a tissue could not be
        processed or vhp itself failed, 130 interrupted, 141 the reader of the output went away.
    """
    settings: dict[str, Any] = {"verbose": False}
    _prepare_streams()
    try:
        code = _run(arguments, settings)
        sys.stdout.flush()
        return code
    except (PipeClosed, BrokenPipeError):
        _silence(sys.stdout)
        return PIPE_CLOSED
    except (KeyboardInterrupt, click.Abort):
        _say("interrupted")
        return INTERRUPTED
    except click.ClickException as error:
        error.show()
        return USAGE
    except VhpError as error:
        _say(f"error: {_message(error)}")
        if error.hint:
            _say(f"hint: {error.hint}")
        _traceback_if_wanted(settings)
        return FAILED if isinstance(error, NoRoomError) else USAGE
    except MemoryError:
        _say("error: out of memory")
        _traceback_if_wanted(settings)
        return FAILED
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        _say(f"error: {place}{error.strerror or error}")
        _traceback_if_wanted(settings)
        return FAILED if error.errno == errno.ENOSPC else USAGE
    except Exception as error:
        _say(f"internal error: {type(error).__name__}: {' '.join(str(error).split())}")
        if not _traceback_if_wanted(settings):
            _say("This is a bug in vhp. Please report it with the output of `VHP_DEBUG=1 vhp ...` and `vhp --version`.")
        return FAILED


def _prepare_streams() -> None:
    """Make stdout and stderr take any text, whether they are closed or their encoding lacks a tissue's name."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            # Closed by the shell (`>&-`). The lowest free descriptor is taken: that of the stream itself.
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _run(arguments: Sequence[str] | None, settings: dict[str, Any]) -> int:
    """Run the group; a command ends by ``ctx.exit(code)``, or by returning its exit code or None."""
    result = cli.main(
        args=None if arguments is None else list(arguments), prog_name="vhp", standalone_mode=False, obj=settings
    )
    return result if isinstance(result, int) else 0


def _message(error: VhpError) -> str:
    if isinstance(error, UnreadableFileError):
        return f"{error.path}: {error.message}" + (f" ({error.where})" if error.where else "")
    return error.message


def _say(text: str) -> None:
    try:
        click.echo(text, err=True)
    except BrokenPipeError:
        _silence(sys.stderr)


def _silence(stream: Any) -> None:
    """Point a stream whose reader is gone at nothing, so that the interpreter can flush it at its end."""
    try:
        descriptor = stream.fileno()
    except (AttributeError, OSError, ValueError):
        return  # no stream of the system: None, closed, or in memory
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, descriptor)
    os.close(null)


def _traceback_if_wanted(settings: dict[str, Any]) -> bool:
    wanted = settings["verbose"] or os.environ.get("VHP_DEBUG", "") not in ("", "0")
    if wanted:
        import traceback

        _say(traceback.format_exc().rstrip())
    return wanted
