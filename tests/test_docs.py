"""The documentation: pages from the code are fresh, links lead somewhere, examples are real."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import click
import numpy as np
import pytest

from vhp_cli.cli import COMMANDS, cli
from vhp_cli.pipeline.recipe import PRESETS, parse_recipe

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", ROOT / "benchmarks" / "README.md", *DOCS.rglob("*.md")])
HAND_WRITTEN = [page for page in PAGES if page.parent.name != "commands" and page.name != "rules.md"]
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
each_written_page = pytest.mark.parametrize(
    "page", HAND_WRITTEN, ids=lambda page: page.relative_to(ROOT).as_posix()
)  # fmt: skip

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page: Path, *languages: str) -> list[str]:
    """Return the fenced blocks of a page in these languages."""
    return [body for language, body in FENCE.findall(page.read_text(encoding="utf-8")) if language in languages]


@pytest.fixture(scope="module")
def make_docs() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_docs", ROOT / "tools" / "make_docs.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_pages_from_the_code_are_fresh(make_docs) -> None:
    assert [str(path) for path in make_docs.stale(ROOT)] == [], "run: make docs"


def test_a_stale_page_is_found_and_mended(make_docs, tmp_path) -> None:
    make_docs.write(tmp_path)
    assert make_docs.stale(tmp_path) == []
    (tmp_path / "docs" / "commands" / "gone.md").write_text("of a command that is gone\n")
    page = tmp_path / "docs" / "commands" / "heal.md"
    page.write_text(page.read_text().replace("--max-deviation", "--deviation"))
    assert [path.name for path in make_docs.stale(tmp_path)] == ["gone.md", "heal.md"]
    make_docs.write(tmp_path)
    assert make_docs.stale(tmp_path) == []


def test_every_option_of_every_command_has_words() -> None:
    for name in COMMANDS:
        for words, command in commands_of(name):
            for option in (one for one in command.params if isinstance(one, click.Option)):
                assert option.help, f"{' '.join(words)} {option.opts[0]}"
            assert command.help, words


def commands_of(name: str) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Yield a command, and those within it."""
    with click.Context(cli) as context:
        command = cli.get_command(context, name)
    assert command is not None
    yield (name,), command
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            yield (name, inner.name or ""), inner


@each_page
def test_links_lead_somewhere(page) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        linked = page if not path else (page.parent / path).resolve()
        assert linked.exists(), target
        if anchor:
            assert anchor in anchors(linked), target


def anchors(page: Path) -> set[str]:
    """Return what a link may name in a page, as GitHub makes it of the headings."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def calls(page: Path) -> Iterator[str]:
    """Yield what a page says that a user may type: `vhp ...`."""
    if page.parent.name == "benchmarks":
        return  # `vhp guarded` is the name of a contestant there
    text = page.read_text(encoding="utf-8")
    for line in text.splitlines():
        bare = line.strip().removeprefix("- ").removeprefix("run: ").removeprefix("$ ").strip()
        if bare.startswith("vhp "):
            # Prose may begin with the name as well: a call goes on with a command, or with an option.
            word = bare.split()[1]
            if word in COMMANDS or word.startswith("-"):
                yield bare
    yield from re.findall(r"`(vhp [^`]+)`", text)


@each_written_page
def test_commands_and_options_are_real(page) -> None:
    for call in calls(page):
        words = shlex.split(call.partition("#")[0].partition("   ")[0], posix=False)[1:]
        known = {"--help", *(name for option in cli.params for name in option.opts)}
        while words and words[0].startswith("-"):
            assert words.pop(0) in known, call
        name = words[0] if words else ""
        if not re.fullmatch(r"[a-z]+", name):
            continue  # a placeholder
        assert name in COMMANDS, call
        options = {"--help", "-h"}
        for _, command in commands_of(name):
            options |= {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
        for word in words[1:]:
            for part in re.findall(r"(?<![\w-])--?[a-z][\w-]*", word.partition("=")[0]):
                assert part in options or (not part.startswith("--") and part[:2] in options), call


@each_written_page
def test_examples_are_valid(page) -> None:
    for text in blocks(page, "toml"):
        tomllib.loads(text)
    for text in blocks(page, "json"):
        json.loads(text)
    if found := blocks(page, "yaml"):
        yaml = pytest.importorskip("yaml")
        for text in found:
            assert yaml.safe_load(text)


def test_the_pipeline_in_the_page_is_one() -> None:
    (text,) = blocks(DOCS / "pipelines.md", "toml")
    found = parse_recipe(text, "page", Path())
    from vhp_cli.commands.recipe_options import arguments_of, find_command

    for stage in found.stages:
        arguments_of(find_command(stage.command)[0], stage.options, Path(), stage.where)


def test_every_preset_is_in_the_page() -> None:
    text = (DOCS / "pipelines.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `(\w+)` \| heal", text, re.MULTILINE) == list(PRESETS)


def test_the_hook_of_pre_commit() -> None:
    yaml = pytest.importorskip("yaml")
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    assert {"id", "name", "entry", "language", "files", "pass_filenames"} <= hook.keys()
    assert hook["entry"].split()[:2] == ["vhp", "check"]
    wanted = re.compile(hook["files"])
    assert all(wanted.search(file) for file in ("model/liver.stl", "a/b.PLY", "x.obj", "vhp.toml", "model/vhp.toml"))
    assert not any(wanted.search(file) for file in ("README.md", "model/liver.stl.txt", "my-vhp.toml"))
    (used,) = (yaml.safe_load(text) for text in blocks(DOCS / "ci.md", "yaml") if text.startswith("repos:"))
    assert used["repos"][0]["hooks"][0]["id"] == hook["id"]


def jobs(text: str) -> Iterator[str]:
    """Yield every line of shell in a recipe for CI."""
    import yaml

    pending: list[object] = [yaml.safe_load(text)]
    while pending:
        value = pending.pop()
        if isinstance(value, dict):
            pending.extend(item for key, item in value.items() if key not in ("run", "script", "before_script"))
            for key in ("run", "script", "before_script"):
                lines = value.get(key, [])
                yield from [lines] if isinstance(lines, str) else lines
        elif isinstance(value, list):
            pending.extend(value)


def test_recipes_for_ci_call_vhp_as_it_is(tmp_path) -> None:
    pytest.importorskip("yaml")
    lines = [line for text in blocks(DOCS / "ci.md", "yaml") for line in jobs(text) if line.startswith("vhp ")]
    assert len(lines) >= 5
    for line in lines:
        name, *rest = shlex.split(line)[1:]
        _, command = next(commands_of(name))
        with command.make_context(name, rest):
            pass


EXIT_CODE = re.compile(r"#.*exit code (\d+)")


def play(texts: list[str], directory: Path) -> list[str]:
    """Run the lines of a page in a directory as a user would, and return them."""
    tools = directory / "bin"
    tools.mkdir()
    for name, words in (("vhp", f"{shlex.quote(sys.executable)} -m vhp_cli"), ("python", shlex.quote(sys.executable))):
        (tools / name).write_text(f'#!/bin/sh\nexec {words} "$@"\n')
        (tools / name).chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "VHP_CACHE_DIR": str(directory / "cache"),
    }
    lines = [line for text in texts for line in text.splitlines() if line.strip()]
    for line in lines:
        wanted = EXIT_CODE.search(line)
        ended = subprocess.run(
            ["/bin/sh", "-c", line], cwd=directory, env=environment, capture_output=True, text=True, check=False
        )
        assert ended.returncode == (int(wanted[1]) if wanted else 0), f"{line}\n{ended.stdout[-2000:]}\n{ended.stderr}"
    return lines


def part(heading: str) -> list[str]:
    """Return the shell blocks of a part of the tutorial."""
    text = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    _, found, rest = text.partition(f"\n## {heading}\n")
    assert found
    return [
        body for language, body in FENCE.findall(re.split(r"^## ", rest, flags=re.MULTILINE)[0]) if language == "sh"
    ]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the lines are for a POSIX shell")
def test_three_commands_lead_from_broken_surfaces_to_an_export(tmp_path) -> None:
    texts = part("A phantom in three commands")
    first = [line for text in texts[:3] for line in text.splitlines()]
    assert [line.split()[:2] for line in first] == [["vhp", "phantom"], ["vhp", "run"], ["vhp", "export"]]
    play(texts, tmp_path)
    report = json.loads((tmp_path / "hfss" / "report.json").read_text())
    assert report["summary"]["passed"]
    assert len(list((tmp_path / "hfss" / "stl").glob("*.stl"))) == 12
    planted = json.loads((tmp_path / "broken" / "planted.json").read_text())["planted"]
    assert len(planted) == 7
    # The shapes are still those of the phantom.
    assert json.loads((tmp_path / "hfss" / "manifest.json").read_text())
    assert (tmp_path / "smooth.toml").read_text().startswith("# The smoothed version")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the lines are for a POSIX shell")
def test_a_label_map_becomes_an_export(tmp_path) -> None:
    nibabel = pytest.importorskip("nibabel")
    pytest.importorskip("skimage")
    names = organs(tmp_path / "labels.nii.gz", nibabel)
    (tmp_path / "names.json").write_text(json.dumps(names))
    (tmp_path / "labels_to_stl.py").write_text((DOCS / "examples" / "labels_to_stl.py").read_text(encoding="utf-8"))
    texts = part("A real segmentation")
    assert texts[0].startswith("python labels_to_stl.py")
    play(texts[:1], tmp_path)
    assert sorted(path.stem for path in (tmp_path / "organs").iterdir()) == sorted(names.values())
    (settings,) = blocks(DOCS / "tutorial.md", "toml")
    (tmp_path / "organs" / "vhp.toml").write_text(settings)
    (tmp_path / "bin" / "vhp").unlink()
    (tmp_path / "bin" / "python").unlink()
    (tmp_path / "bin").rmdir()
    play(texts[1:], tmp_path)
    assert (tmp_path / "torso.html").stat().st_size > 10_000
    assert json.loads((tmp_path / "cst" / "report.json").read_text())["summary"]["passed"]


def organs(path: Path, nibabel) -> dict[str, str]:
    """Write a label map of four organs that share walls, as a segmentation gives them."""
    x, y, z = np.mgrid[:44, :44, :44].astype(float)

    def ball(centre, radii):
        return sum(((a - b) / c) ** 2 for a, b, c in zip((x, y, z), centre, radii, strict=True)) < 1

    labels = np.zeros(x.shape, np.uint8)
    labels[ball((22, 22, 22), (14, 11, 9))] = 5
    labels[ball((35, 22, 22), (6, 7, 7)) & (labels == 0)] = 1
    labels[ball((14, 22, 31), (6, 5, 4)) & (labels == 0)] = 6
    labels[(np.hypot(x - 22, y - 34) < 2.2) & (z > 6) & (z < 38) & (labels == 0)] = 64
    affine = np.diag([-3.0, 3.0, 3.0, 1.0])
    affine[:3, 3] = [60, -60, 10]
    nibabel.save(nibabel.Nifti1Image(labels, affine), path)
    return {"5": "liver", "1": "spleen", "6": "stomach", "64": "portal_vein_and_splenic_vein"}


def test_the_index_leads_to_every_page() -> None:
    linked = set(re.findall(r"\]\(([^)#]+\.md)\)", (DOCS / "README.md").read_text(encoding="utf-8")))
    pages = {page.name for page in DOCS.glob("*.md")} - {"README.md"}
    assert pages <= linked
