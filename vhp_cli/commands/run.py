"""``vhp run``: a whole pipeline in one command."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.common import report_base, report_target, show_report, write_reports
from vhp_cli.commands.options import judging_options, model_options, report_options, run_options
from vhp_cli.commands.recipe_options import (
    OF_ALL,
    SPEED,
    arguments_of,
    check_arguments,
    find_command,
    flags_of,
    option_names,
    refuse_unknown,
)
from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.pipeline.recipe import Recipe, StageTable
    from vhp_cli.pipeline.run import Step

_PRESETS = click.Choice(["base", "smooth", "coarse", "accurate"])
_POSITIVE = click.FloatRange(min=0, min_open=True)


def _show_preset(ctx: click.Context, parameter: click.Parameter, value: str | None) -> None:
    if value is None or ctx.resilient_parsing:
        return
    from vhp_cli.pipeline.recipe import preset_text

    click.echo(preset_text(value), nl=False)
    ctx.exit()


@click.command("run", options_metavar="[OPTIONS] [PIPELINE.toml]")
@model_options
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT",
    type=click.Path(path_type=Path, file_okay=False),
    help="Directory for the results: one for each stage, surfaces/ for the final ones, and report.json. What an "
    "earlier run has done there is not done again.",
)
@click.option("--preset", type=_PRESETS, help="Run this pipeline, which comes with vhp, instead of a file.")
@click.option(
    "--show-preset",
    type=_PRESETS,
    is_eager=True,
    expose_value=False,
    callback=_show_preset,
    help="Print the file of a preset, to change it, and exit.",
)
@click.option("--overwrite", is_flag=True, help="Run every stage anew.")
@click.option("--dry-run", is_flag=True, help="Check the pipeline and list its stages.")
@judging_options
@report_options
@click.option(
    "--timeout",
    type=_POSITIVE,
    metavar="S",
    help="Seconds for one tissue in each stage. [default: that of each command]",
)
@click.option("--memory", type=_POSITIVE, metavar="GB", help="Memory for one worker. [default: that of each command]")
@run_options
@click.pass_context
def run(
    ctx: click.Context,
    /,
    model: tuple[Path, ...],
    output: Path,
    preset: str | None,
    overwrite: bool,
    dry_run: bool,
    reports: tuple[str, ...],
    form: str | None,
    **given: Any,
) -> None:
    """Run the stages of PIPELINE.toml, or of a preset, on a model: vhp run PIPELINE.toml MODEL -o OUT.

    Every stage is a command of vhp with its options, and its results are kept: a run that was stopped goes on where it
    was, and a stage is run again only if its options, its input or vhp itself changed. All settings are checked before
    the first stage starts. Options given here come before those of the pipeline.

    Exit code: 0 the final surfaces and all that was made of them passed, 1 errors remain, 2 wrong usage or nothing
    readable, 3 a tissue could not be processed.
    """
    from vhp_cli.config import load_settings
    from vhp_cli.pipeline.output import REPORT
    from vhp_cli.pipeline.recipe import read_preset, read_recipe
    from vhp_cli.pipeline.run import FINAL, check_output, run_pipeline
    from vhp_cli.pipeline.run_report import pipeline_report, surfaces_place

    if preset is not None and model[0].suffix.lower() == ".toml":
        raise UsageError(f"--preset {preset} and {model[0]} exclude each other")
    if preset is None and model[0].suffix.lower() != ".toml":
        raise UsageError("which pipeline?", hint="vhp run PIPELINE.toml MODEL -o OUT, or --preset NAME")
    if preset is None and len(model) == 1:
        raise UsageError("which model?", hint="vhp run PIPELINE.toml MODEL -o OUT")
    recipe = read_preset(preset) if preset is not None else read_recipe(model[0])
    paths = model if preset is not None else model[1:]
    targets = [report_target(report, form) for report in reports]
    flags = dict(flags_of(ctx.command, {**given, "model": None}))
    flags.pop("config", None)
    config = _config(given["config"], recipe, paths)
    steps = _steps(recipe, flags, config)
    asked = any("--recursive" in step.arguments for step in steps)
    recursive = load_settings(config=config, model=paths, recursive=asked).recursive
    check_output(paths, output, recursive=recursive)
    _check(steps, paths, output)
    talk: dict[str, Any] = ctx.obj or {}
    if dry_run:
        for step in steps:
            click.echo(shlex.join([step.directory, *step.words, *step.arguments, *step.speed]))
        return

    def tell(step: Step, how: str) -> None:
        if not talk.get("quiet"):
            words = {"reused": "is as before", "taken up": "goes on", "run": "runs"}[how]
            click.echo(f"{step.directory} {words}", err=True)

    talking = [f"--{name}" for name in ("quiet", "verbose") if talk.get(name)]
    done = run_pipeline(
        steps, paths, output, recursive=recursive, flags=talking, overwrite=overwrite, config=config, tell=tell
    )
    report = pipeline_report(done, recipe.name, paths, {})
    # Files are named as seen from the output directory, or from the model, if no stage has made surfaces.
    base = report_base((output,) if surfaces_place(done) else paths)
    write_reports(report, [*targets, (output / REPORT, "json")], base)
    to_stdout = next((target_form for path, target_form in targets if path is None), form)
    show_report(report, to_stdout or "table", base, **talk)
    if not talk.get("quiet"):
        for name in done.left_over:
            click.echo(f"note: {output / name} is of another pipeline, and was left alone", err=True)
        if done.surfaces:
            click.echo(f"surfaces: {output / FINAL}", err=True)
    ctx.exit(report["pipeline"]["exit_code"])


def _config(flag: Path | None, recipe: Recipe, model: tuple[Path, ...]) -> Path | None:
    """Return the settings file that all stages read, as only the first of them sees the model."""
    if flag is not None:
        return flag
    named = recipe.options.get("config")
    if isinstance(named, str):
        return recipe.directory / named
    for directory in (path for path in model if path.is_dir()):
        if (directory / "vhp.toml").is_file():
            return directory / "vhp.toml"
        if (directory / "pyproject.toml").is_file():
            from vhp_cli.config import load_settings

            if load_settings(model=[directory]) != load_settings():
                raise UsageError(
                    f"{directory / 'pyproject.toml'}: a pipeline can't take its settings from there",
                    hint="put what is in [tool.vhp] into a file vhp.toml beside it",
                )
    return None


def _steps(recipe: Recipe, flags: Mapping[str, object], config: Path | None) -> list[Step]:
    """Return the stages, ready to run; a check is added where nothing judges the final surfaces."""
    from vhp_cli.pipeline.recipe import SURFACES, StageTable

    tables = list(recipe.stages)
    last = max((index for index, table in enumerate(tables) if table.command in SURFACES), default=-1)
    if all(table.command != "check" for table in tables[last + 1 :]):
        tables.insert(last + 1, StageTable("check", "check", "continue", {}, f"{recipe.name}: final check"))
    known = {name for table in tables for name in option_names(find_command(table.command)[0])}
    shared = {key: value for key, value in recipe.options.items() if key != "config"}
    for name in shared:
        refuse_unknown(name, dict.fromkeys(known), f"{recipe.name}: [options]")
    return [_step(table, number, recipe, shared, flags, config) for number, table in enumerate(tables, start=1)]


def _step(
    table: StageTable,
    number: int,
    recipe: Recipe,
    shared: Mapping[str, object],
    flags: Mapping[str, object],
    config: Path | None,
) -> Step:
    from vhp_cli.pipeline.run import Step

    command, words = find_command(table.command)
    where, names = table.where, option_names(command)
    for name in table.options:
        refuse_unknown(name, names, where)
        if name in OF_ALL:
            raise UsageError(f"{where}: {name} belongs to all stages", hint="put it into [options]")
    # One option may have two names: the later source counts, by whichever it was given.
    chosen: dict[str | None, tuple[str, object]] = {}
    for source in (shared, table.options, flags):
        own: dict[str | None, tuple[str, object]] = {}
        for name, value in source.items():
            if name not in names:
                continue
            key = names[name][0].name
            if key in own:
                raise UsageError(f"{where}: {own[key][0]} and {name} are the same option")
            own[key] = (name, value)
        chosen |= own
    values = dict(chosen.values())
    arguments = arguments_of(command, values, recipe.directory, where)
    deciding, files = arguments.deciding, arguments.files
    if config is not None and "config" in names and "config" not in values:
        deciding, files = (*deciding, f"--config={config}"), (*files, config)
    options = {name: value for name, value in values.items() if name not in SPEED}
    directory = f"{number:02d}-{table.name}"
    return Step(directory, words, options, deciding, where, arguments.speed, files, table.on_error)


def _check(steps: list[Step], model: tuple[Path, ...], output: Path) -> None:
    """Find what is wrong with any stage before the first one starts."""
    from vhp_cli.pipeline.run import plain
    from vhp_cli.pipeline.run_record import RECORDS

    nowhere, paths = output / RECORDS / "nothing", [plain(path) for path in model]
    for step in steps:
        for file in step.files:
            if not file.exists():
                raise UsageError(f"{step.where}: {file}: no such file or directory")
        command, words = find_command(step.command)
        check_arguments(words, command, [*step.arguments, *step.speed], paths, nowhere, step.where)
