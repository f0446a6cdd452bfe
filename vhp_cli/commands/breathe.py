"""``vhp breathe``: respiratory motion of a torso model."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.options import comma_list, model_options, report_options, run_options

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.stages.breathe.options import BreatheOptions
    from vhp_cli.stages.breathe.sequence import Sequence

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

DEFAULT = "run"
_POSITIVE = click.FloatRange(min=0, min_open=True)


class DefaultGroup(click.Group):
    """A group that runs `DEFAULT` where no command of its own is named: ``vhp breathe MODEL -o OUT``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the default command in front of what names none."""
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = [DEFAULT, *args]
        return super().parse_args(ctx, args)


def _combined(*decorators: Decorator) -> Decorator:
    def apply(function: Callable[..., Any]) -> Callable[..., Any]:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return apply


_breath_options = _combined(
    click.option(
        "--preset",
        type=click.Choice(["quiet", "deep", "shallow"]),
        help="Volume change and travel of a quiet (0.32 l, 20 mm), deep (0.592 l, 37 mm) or shallow breath (0.16 l, "
        "10 mm). [default: quiet]",
    ),
    click.option("--volume-change", type=_POSITIVE, metavar="L", help="What the lungs gain, in litres."),
    click.option("--travel", type=_POSITIVE, metavar="MM", help="How far their lowest point travels."),
    click.option(
        "--forward",
        type=click.FloatRange(min=0),
        metavar="MM",
        help="How far they move forward. [default: 3 mm for each 200 mm of their height]",
    ),
    click.option(
        "--ribs",
        type=click.Choice(["follow", "least"]),
        help="Lift the ribs so that the front of the chest goes forward with the lungs, as far as there is room, or as "
        "little as the lungs leave them. [default: follow]",
    ),
    click.option("--steps", type=click.IntRange(1, 1000), metavar="N", help="Steps to full inhalation. [default: 11]"),
    click.option("--period", type=_POSITIVE, metavar="S", help="Seconds of one breath. [default: 5]"),
)

_frame_options = _combined(
    click.option(
        "--frames",
        type=click.IntRange(2),
        metavar="N",
        help="Frames evenly spaced in time. [default: 2 STEPS + 1, at whole steps]",
    ),
    click.option("--times", metavar="S,S,...", help="Times of the frames in seconds, instead."),
)

_limit_options = _combined(
    click.option(
        "--gap",
        type=click.FloatRange(min=0),
        metavar="MM",
        help="Gap to keep, or that at rest if smaller. [default: 1]",
    ),
    click.option(
        "--mass-tolerance", type=_POSITIVE, metavar="SHARE", help="Most change of the model's mass. [default: 0.001]"
    ),
    click.option(
        "--lung-mass",
        type=click.Choice(["fixed-mass", "fixed-density", "none"]),
        help="What happens to the mass of the lungs: it stays as air weighs nothing, it grows with their volume, or "
        "there is none. [default: fixed-mass]",
    ),
    click.option(
        "--config",
        type=click.Path(path_type=Path, dir_okay=False),
        help="Settings file. [default: vhp.toml in MODEL, else [tool.vhp] of its pyproject.toml]",
    ),
)

_output_options = _combined(
    click.option(
        "-o",
        "--output",
        required=True,
        metavar="OUT",
        type=click.Path(path_type=Path, file_okay=False),
        help="Directory for the results: frames/, rejected/, scripts/, sequence.toml and report.json.",
    ),
    click.option("--overwrite", is_flag=True, help="Replace what OUT holds."),
)

_sequence_options = _combined(
    click.option(
        "--sequence",
        metavar="FILE|NAME",
        required=True,
        help="Sequence to play: a file, or vhp-female, the published one.",
    ),
    click.option(
        "--as-printed",
        is_flag=True,
        help="The published sequence with its errors, instead of the recommended readings.",
    ),
)


@click.group("breathe", cls=DefaultGroup, subcommand_metavar="[COMMAND] MODEL... [OPTIONS]")
def breathe() -> None:
    """Make a torso model breathe.

    `vhp breathe MODEL -o OUT` is short for `vhp breathe run`: it finds how every tissue moves, proves that nothing
    collides at any moment, and writes the frames. A model in a directory that is called like a command is named with
    its path: ./fit.
    """


@breathe.command("run")
@model_options
@_output_options
@click.option(
    "--sequence", metavar="FILE|NAME", help="Play this sequence instead of fitting one: a file, or vhp-female."
)
@click.option(
    "--as-printed", is_flag=True, help="The published sequence with its errors, instead of the recommended readings."
)
@_breath_options
@_frame_options
@_limit_options
@report_options
@run_options
@click.pass_context
def run(ctx: click.Context, /, **given: Any) -> None:
    """Fit a sequence to MODEL, prove it, and write its frames (the default)."""
    _run(ctx, given, fitting=given["sequence"] is None, with_frames=True)


@breathe.command("fit")
@model_options
@_output_options
@_breath_options
@_limit_options
@report_options
@run_options
@click.pass_context
def fit(ctx: click.Context, /, **given: Any) -> None:
    """Fit a sequence to MODEL and write it to OUT/sequence.toml, without frames."""
    _run(ctx, given, fitting=True, with_frames=False)


@breathe.command("play")
@model_options
@_output_options
@_sequence_options
@_frame_options
@_limit_options
@report_options
@run_options
@click.pass_context
def play(ctx: click.Context, /, **given: Any) -> None:
    """Write the frames of a given sequence; those that fail go to OUT/rejected."""
    _run(ctx, given, fitting=False, with_frames=True)


@breathe.command("verify")
@model_options
@_sequence_options
@_frame_options
@_limit_options
@report_options
@run_options
@click.pass_context
def verify(ctx: click.Context, /, **given: Any) -> None:
    """Test a sequence on MODEL and write nothing: every frame, and every moment between."""
    _run(ctx, given, fitting=False, with_frames=False)


@breathe.command("script")
@model_options
@_output_options
@_sequence_options
@click.option(
    "--for",
    "targets",
    callback=comma_list,
    metavar="PROGRAMS",
    help="Some of aedt, aedt-native, cst, matlab, separated by commas. [default: all]",
)
@_limit_options
@report_options
@run_options
@click.pass_context
def script(ctx: click.Context, /, **given: Any) -> None:
    """Write scripts that build the parametric sweep of a sequence in other programs, and the frames they import."""
    from vhp_cli.errors import UsageError
    from vhp_cli.stages.breathe.scripts import TARGETS

    for target in given["targets"]:
        if target not in TARGETS:
            raise UsageError(f"--for {target}: no such program", hint=f"programs: {', '.join(TARGETS)}")
    _run(ctx, given, fitting=False, with_frames=True)


def _run(ctx: click.Context, given: Mapping[str, Any], *, fitting: bool, with_frames: bool) -> None:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from vhp_cli.commands.common import ERRORS, PASSED, ProgressBar, report_base, report_target, write_reports
    from vhp_cli.model import find_model
    from vhp_cli.pipeline.breathe import Request, run_breathe
    from vhp_cli.pipeline.cache import default_directory
    from vhp_cli.pipeline.output import REPORT

    settings, options = _settings(given)
    targets = [report_target(report, given["form"]) for report in given["reports"]]
    found = find_model(given["model"], recursive=settings.recursive)
    sequence = None if fitting else load_sequence(given["sequence"], as_printed=given["as_printed"])
    out: Path | None = given.get("output")
    talk = ctx.obj or {}
    targets_of_scripts = tuple(given.get("targets") or ()) or None
    request = Request(out, sequence, with_frames, given.get("overwrite", False), targets_of_scripts)
    with ProgressBar(quiet=talk.get("quiet", False)) as progress:
        done = run_breathe(
            found,
            options,
            settings,
            request,
            paths=given["model"],
            jobs=given["jobs"],
            cache_directory=default_directory() if given["cache"] else None,
            progress=progress,
        )
    base = report_base(given["model"])
    written = [*targets, (out / REPORT, "json")] if out is not None else targets
    write_reports(done.report, written, base)
    to_stdout = next((form for path, form in targets if path is None), given["form"])
    _show(done.report, to_stdout, base, **talk)
    if not talk.get("quiet"):
        for note in done.notes:
            click.echo(f"note: {note}", err=True)
    ctx.exit(PASSED if done.report["summary"]["passed"] else ERRORS)


def _show(report: Any, form: str | None, base: str, *, quiet: bool = False, verbose: bool = False) -> None:
    if form not in (None, "table"):
        from vhp_cli.commands.common import rendered

        click.echo(rendered(report, form, base), nl=False)
    elif not quiet:
        from rich.console import Console

        from vhp_cli.report.breathing import print_breathing

        print_breathing(report, Console(), verbose=verbose)


def load_sequence(source: str, *, as_printed: bool) -> Sequence:
    """Return the sequence of a file, or the published one of this name.

    Raises
    ------
    UsageError
        If there is neither, or the file can't be read.
    """
    from vhp_cli.errors import UsageError
    from vhp_cli.stages.breathe.published import NAMES, published_sequence
    from vhp_cli.stages.breathe.sequence_file import parse_sequence

    path = Path(source)
    if source in NAMES and not path.exists():
        return published_sequence(source, as_printed=as_printed)
    if as_printed:
        raise UsageError(f"--as-printed is for the published sequence, not for {source}")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UsageError(
            f"{source}: can't read the sequence: {reason}", hint=f"a file, or one of {', '.join(NAMES)}"
        ) from error
    return parse_sequence(text, source)


def _settings(given: Mapping[str, Any]) -> tuple[Settings, BreatheOptions]:
    from vhp_cli.config import load_settings
    from vhp_cli.stages.breathe.options import KEYS, BreatheOptions

    settings = load_settings(
        config=given["config"],
        model=given["model"],
        units=given["units"],
        weld_tolerance_mm=given["weld_tolerance"],
        recursive=given["recursive"],
    )
    flags = {key: given.get(key.replace("-", "_")) for key in KEYS}
    options = BreatheOptions().changed(settings.stages.get("breathe", {}), "breathe")
    return settings, options.changed({key: value for key, value in flags.items() if value is not None}, "command line")
