"""What an installed vhp promises: light start-up, exit codes, one version, a compiled library that is its own."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import click
import pytest
from shapes import sphere

import vhp_cli
from vhp_cli import cli
from vhp_cli.errors import UnreadableFileError, UsageError, VhpError
from vhp_cli.formats import write_mesh
from vhp_cli.kernels import build

ROOT = Path(__file__).resolve().parents[1]
HEAVY = {"trimesh", "pymeshlab", "pytetwild", "pyvista", "vtk", "scipy", "igl", "fcl", "pandas"}


def run(*arguments: str, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=ROOT,
        env={**os.environ, **(env or {})},
    )


def modules_after(code: str) -> set[str]:
    done = run("-c", f"{code}\nimport sys; print(*sorted(sys.modules))")
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split("\n")[-2].split())


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch):
    """Make `vhp check` do what the test says."""

    def install(action):
        @click.command("check")
        def check():
            return action()

        monkeypatch.setattr(cli.LazyGroup, "get_command", lambda self, ctx, name: check)

    return install


def fail_with(error: BaseException):
    def action():
        raise error

    return action


# Start-up


def test_help_imports_no_library_but_click():
    done = run("-X", "importtime", "-m", "vhp_cli", "--help")
    assert done.returncode == 0
    imported = {line.rsplit("|", 1)[-1].strip() for line in done.stderr.splitlines() if "|" in line}
    assert "click" in imported
    assert "vhp_cli.cli" in imported
    top = {name.partition(".")[0] for name in imported}
    assert not top & (HEAVY | {"numpy", "rich", "ctypes"})
    assert "importlib.metadata" not in imported
    assert not {name for name in imported if name.startswith("vhp_cli.commands.")}


@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_a_commands_help_imports_no_library_but_click(name):
    loaded = modules_after(f"from vhp_cli.cli import main\nassert main(['{name}', '--help']) == 0")
    assert f"vhp_cli.commands.{name}" in loaded
    assert not loaded & (HEAVY | {"numpy", "rich"})


def test_checking_a_model_imports_numpy_click_and_rich_only(tmp_path):
    model = tmp_path / "model"
    loaded = modules_after(
        "from vhp_cli.cli import main\n"
        f"assert main(['phantom', {str(model)!r}]) == 0\n"
        f"assert main(['check', {str(model)!r}]) == 0"
    )
    assert "numpy" in loaded
    assert not loaded & HEAVY


# The table of commands and the help


@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_every_entry_of_the_table_is_a_command_with_help(name):
    context = click.Context(cli.cli, info_name="vhp")
    found = cli.cli.get_command(context, name)
    assert isinstance(found, click.Command)
    assert found.name == name
    assert found.help
    for parameter in found.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"vhp {name} {parameter.opts[0]} has no help"


def test_every_command_module_is_in_the_table():
    modules = {path.stem for path in (ROOT / "vhp_cli" / "commands").glob("*.py") if not path.stem.startswith("_")}
    listed = {entry.target.partition(":")[0].rpartition(".")[2] for entry in cli.COMMANDS.values()}
    assert listed <= modules
    sources = {name: (ROOT / f"vhp_cli/commands/{name}.py").read_text() for name in modules}
    with_command = {name for name, text in sources.items() if "@click.command" in text or "@click.group" in text}
    assert with_command == listed


def test_help_lists_the_commands(capsys):
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    for name, entry in cli.COMMANDS.items():
        assert f"{name} " in text
        assert entry.summary.split(";")[0] in text
    assert cli.main(["-h"]) == 0
    assert capsys.readouterr().out == text


def test_a_misspelt_command_is_named_with_the_nearest_one(capsys):
    assert cli.main(["chek"]) == 2
    captured = capsys.readouterr()
    assert "no such command 'chek'. Did you mean 'check'?" in captured.err
    assert captured.out == ""


@pytest.mark.parametrize("arguments", [["--nonsense"], ["--quiet", "--verbose", "rules"], ["check"]])
def test_wrong_usage_exits_2(arguments, capsys):
    assert cli.main(arguments) == 2
    assert capsys.readouterr().out == ""


def test_version_names_the_libraries(capsys):
    assert cli.main(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"vhp {vhp_cli.__version__}"
    assert [line.split()[0] for line in lines[2:]] == list(cli.VERSIONED)


def test_version_is_that_of_the_metadata():
    from importlib import metadata

    try:
        installed = metadata.version("vhp-cli")
    except metadata.PackageNotFoundError:
        pytest.skip("runs from a source tree that isn't installed")
    assert installed == vhp_cli.__version__


def test_the_libraries_of_version_are_the_dependencies():
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    assert sorted(line.partition(">")[0] for line in project["dependencies"]) == sorted(cli.VERSIONED)


# Errors and exit codes


@pytest.mark.parametrize("code", [0, 1, 3])
def test_the_exit_code_of_a_command_is_passed_on(command, code):
    command(lambda: code)
    assert cli.main(["check"]) == code
    command(lambda: click.get_current_context().exit(code))
    assert cli.main(["check"]) == code


@pytest.mark.parametrize(
    ("error", "code", "expected"),
    [
        (VhpError("no good", hint="do better"), 2, "error: no good\nhint: do better\n"),
        (UsageError("no good"), 2, "error: no good\n"),
        (UnreadableFileError(Path("a.stl"), "cut short", where="byte 84"), 2, "error: a.stl: cut short (byte 84)\n"),
        (PermissionError(13, "Permission denied", "out.json"), 2, "error: out.json: Permission denied\n"),
        (click.ClickException("no good"), 2, "Error: no good\n"),
        (click.FileError("a.toml", "gone"), 2, "Error: Could not open file 'a.toml': gone\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (click.Abort(), 130, "interrupted\n"),
        (MemoryError(), 3, "error: out of memory\n"),
    ],
)
def test_errors_become_words_and_an_exit_code(command, capsys, monkeypatch, error, code, expected):
    monkeypatch.delenv("VHP_DEBUG", raising=False)
    command(fail_with(error))
    assert cli.main(["check"]) == code
    captured = capsys.readouterr()
    assert captured.err.lstrip("\n") == expected
    assert captured.out == ""


def test_an_internal_error_is_one_line_and_exit_3(command, capsys, monkeypatch):
    monkeypatch.delenv("VHP_DEBUG", raising=False)
    command(fail_with(ZeroDivisionError("division\nby zero")))
    assert cli.main(["check"]) == 3
    text = capsys.readouterr().err
    assert text.startswith("internal error: ZeroDivisionError: division by zero\n")
    assert "report" in text
    assert "Traceback" not in text


def test_an_internal_error_shows_its_traceback_on_demand(command, capsys, monkeypatch):
    command(fail_with(ZeroDivisionError()))
    monkeypatch.delenv("VHP_DEBUG", raising=False)
    assert cli.main(["--verbose", "check"]) == 3
    assert "Traceback" in capsys.readouterr().err
    monkeypatch.setenv("VHP_DEBUG", "1")
    assert cli.main(["check"]) == 3
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="pipes close in another way")
@pytest.mark.parametrize("printer", ["click.echo", "rich.get_console().print"])
def test_a_closed_pipe_is_quiet_and_no_pass(printer):
    code = (
        "import sys, click, rich\nfrom vhp_cli import cli\n"
        f"command = click.Command('check', callback=lambda: [{printer}('x' * 70) for _ in range(10_000)])\n"
        "cli.LazyGroup.get_command = lambda *_: command\n"
        "sys.exit(cli.main(['check']))"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.read(10)
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(timeout=60) == cli.PIPE_CLOSED


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")
@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-", "2>&-"])
@pytest.mark.parametrize(("arguments", "code"), [("rules", 0), ("--version", 0), ("check missing", 2)])
def test_closed_streams_do_not_change_the_exit_code(closed, arguments, code):
    done = subprocess.run(
        f'"{sys.executable}" -m vhp_cli {arguments} {closed}',
        shell=True, capture_output=True, text=True, timeout=60, check=False, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert "internal error" not in done.stderr


def test_silencing_what_is_no_stream_of_the_system():
    cli._silence(None)
    cli._silence(io.StringIO())


@pytest.mark.parametrize("encoding", ["latin-1", "cp1252", "ascii"])
def test_names_that_the_console_lacks_are_escaped(tmp_path, encoding):
    name = "肝臓"
    write_mesh(tmp_path / f"{name}.stl", sphere(10))
    for options in (["--dry-run"], [], ["--format", "json"]):
        done = subprocess.run(
            [sys.executable, "-m", "vhp_cli", "check", str(tmp_path), *options],
            capture_output=True, timeout=60, check=False, cwd=ROOT,
            env={**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
        )  # fmt: skip
        assert done.returncode in (0, 1), done.stderr
        shown = done.stdout + done.stderr
        assert rb"\u809d" in shown or name.encode() in shown  # click writes UTF-8 where Python says ASCII


# The compiled library


def copy_of_the_package(tmp_path: Path) -> Path:
    package = tmp_path / "vhp_cli"
    (package / "kernels").mkdir(parents=True)
    for name in ("__init__.py", "errors.py", "kernels/__init__.py", "kernels/_library.py", "kernels/build.py"):
        shutil.copy(ROOT / "vhp_cli" / name, package / name)
    (package / "kernels" / "one.c").write_text(
        '__attribute__((visibility("default"))) int vhp_one(void);\nint vhp_one(void) { return 1; }\n'
    )
    return package / "kernels"


LOAD = (
    "from vhp_cli.errors import KernelError\n"
    "try:\n    from vhp_cli.kernels import _library\n"
    "except KernelError as error:\n    print('refused:', error, '/', error.hint)\n"
    "else:\n    print(_library.function('vhp_one', _library.i32, [])())"
)


@pytest.mark.skipif(build.find_compiler() is None, reason="no C compiler here")
def test_a_library_older_than_its_sources_is_refused(tmp_path):
    kernels = copy_of_the_package(tmp_path)
    env = {key: value for key, value in os.environ.items() if key != "VHP_KERNELS"} | {"PYTHONPATH": str(tmp_path)}

    def load() -> str:
        done = subprocess.run(
            [sys.executable, "-c", LOAD], capture_output=True, text=True, check=False, cwd=tmp_path, env=env
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    # Libraries of other platforms, or copies, are no substitute.
    for name in ("_kernels.so.old", "_kernels.o", "_kernels.pyd"):
        (kernels / name).write_bytes(b"")
    refusal = load()
    assert refusal.startswith("refused: the compiled kernels can't be loaded")
    assert f"{build.LIBRARY.name}:" in refusal
    compiled = subprocess.run(
        [sys.executable, str(kernels / "build.py"), "--check"], capture_output=True, text=True, check=False
    )
    assert compiled.returncode == 0, compiled.stderr
    assert load() == "1\n"
    (kernels / "one.c").write_text((kernels / "one.c").read_text().replace("return 1", "return 2"))
    refusal = load()
    assert refusal.startswith("refused: the compiled kernels are older than their C sources")
    assert "make kernels" in refusal
    (kernels / "one.c").unlink()
    assert load() == "1\n"


@pytest.mark.skipif(build.find_compiler() is None, reason="no C compiler here")
def test_a_failing_compiler_leaves_the_old_library(tmp_path):
    target = tmp_path / "kernels.so"
    target.write_bytes(b"old")
    with pytest.raises(RuntimeError, match="nonsense"):
        build.compile_kernels(target, extra=["-nonsense"])
    assert target.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["kernels.so"]


@pytest.mark.skipif(build.find_compiler() is None, reason="no C compiler here")
def test_unsafe_arithmetic_is_refused(tmp_path):
    with pytest.raises(RuntimeError, match="ffast-math"):
        build.compile_kernels(tmp_path / "kernels.so", extra=["-ffast-math"])


# Packaging


def test_supported_python_versions_agree():
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    versions = [line.rsplit(" ", 1)[-1] for line in project["classifiers"] if "Python :: 3." in line]
    assert project["requires-python"] == f">={versions[0]}"
    assert versions == ["3.11", "3.12", "3.13", "3.14"]


@pytest.mark.slow
@pytest.mark.skipif(build.find_compiler() is None, reason="no C compiler here")
def test_the_wheel_holds_the_library_the_data_and_no_sources(tmp_path):
    done = run("-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(tmp_path), str(ROOT))
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name.startswith(f"vhp_cli-{vhp_cli.__version__}-py3-none-")
    assert not wheel.name.endswith("-any.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    kernels = {Path(name).name for name in names if name.startswith("vhp_cli/kernels/")}
    assert build.LIBRARY.name in kernels
    assert not {name for name in names if name.endswith((".c", ".h"))}
    data = {f"vhp_cli/data/{path.name}" for path in (ROOT / "vhp_cli" / "data").iterdir() if path.is_file()}
    assert data <= names
    assert {"vhp_cli/py.typed", "vhp_cli/cli.py"} <= names
