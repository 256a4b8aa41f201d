"""Modules that `$PYTHONPATH` puts in the place of those of swarmd, as a sourced ROS does."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from swarmd.core.python_path import import_fault, replaced_modules, replaced_text
from swarmd.operator.cli import entry


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on `$PYTHONPATH` with a package of Python 2, a module and one of no other name."""
    for name, code in (
        ("yaml/__init__.py", 'print "old"\n'),
        ("numpy/__init__.py", 'raise ImportError("no module named _multiarray_umath")\n'),
        ("enum.py", "X = 1\n"),
        ("my_robot/__init__.py", "X = missing\n"),
        ("msgspec-0.1.dist-info/METADATA", ""),
        ("click.txt", ""),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(code)
    monkeypatch.setenv("PYTHONPATH", f"/nonexistent:{tmp_path}:")
    return tmp_path


def error_of(path: Path) -> Exception:
    """The error of the import of a file."""
    spec = importlib.util.spec_from_file_location("tried", path)
    assert spec is not None
    assert spec.loader is not None
    try:
        spec.loader.exec_module(importlib.util.module_from_spec(spec))
    except Exception as error:
        return error
    raise AssertionError(f"{path} is imported")


def test_the_modules_that_are_replaced_are_those_that_this_python_has(workspace: Path) -> None:
    assert replaced_modules() == dict.fromkeys(("yaml", "numpy", "enum"), workspace)
    text = replaced_text()
    assert all(word in text for word in ("yaml", "numpy", "enum", str(workspace), "PYTHONPATH"))
    assert replaced_text({}) == ""


@pytest.mark.parametrize("name", ["yaml", "numpy"])
def test_an_error_of_such_a_module_is_one_line_of_the_entry(
    workspace: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    error = error_of(workspace / name / "__init__.py")
    with pytest.raises(SystemExit) as ended:
        entry._exit_with(error)
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert f"{name} comes from PYTHONPATH ({workspace})" in told
    assert "env -u PYTHONPATH" in told


def test_names_that_such_a_module_lacks_are_an_error_of_it(workspace: Path) -> None:
    spec = importlib.util.spec_from_file_location("enum", workspace / "enum.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.raises(AttributeError) as lacking:
        module.Enum  # noqa: B018
    assert import_fault(lacking.value).startswith("enum comes")
    lacking_name = ImportError("cannot import name 'Enum'", path=str(workspace / "enum.py"))
    assert import_fault(lacking_name).startswith("enum comes")


def test_another_error_keeps_its_traceback(
    workspace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry._exit_with(error_of(workspace / "my_robot" / "__init__.py"))
    entry._exit_with(ValueError("a defect of swarmd"))
    monkeypatch.delenv("PYTHONPATH")
    entry._exit_with(error_of(workspace / "yaml" / "__init__.py"))
