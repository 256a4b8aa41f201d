"""Finding plugins by name, with distributions laid out as pip would."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from swarmd import plugins
from swarmd.core.errors import PluginError

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def outsider(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed distribution `outsider` 2.1 with a plugin of every kind."""
    site = tmp_path / "site"
    info = site / "outsider-2.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: outsider\nVersion: 2.1\n"
        "Requires-Dist: numpy\n"
        'Requires-Dist: absent-core>=4; extra == "far"\nProvides-Extra: far\n'
    )
    (info / "entry_points.txt").write_text(
        "[swarmd.patterns]\nswirl = outsider_ok:Swirl\n"
        "[swarmd.drivers]\n"
        "kit = outsider_ok:Kit\nneedy = outsider_needy:Kit\nlost = outsider_ok:Nothing\n"
        "broken = outsider_broken:Kit\ngone = outsider_gone:Kit\n"
        "[swarmd.commands]\nwave = outsider_ok:wave\nfar = outsider_needy:wave\n"
        "deep = outsider_deep.verbs.deep:deep\n"
    )
    (site / "outsider_ok.py").write_text("Kit = object()\nwave = object()\n")
    verbs = site / "outsider_deep" / "verbs"
    verbs.mkdir(parents=True)
    (site / "outsider_deep" / "__init__.py").write_text("raise RuntimeError('imported')\n")
    (verbs / "__init__.py").touch()
    (verbs / "deep.py").write_text(
        "import absent\n\n\n@absent.command()\ndef deep(\n    depth: int,\n) -> None:\n"
        '    """Dives.\n\n    And comes up.\n    """\n\n\ndef other() -> None: ...\n'
    )
    (site / "outsider_needy.py").write_text("import absent.deep\n")
    (site / "outsider_broken.py").write_text("def (\n")
    monkeypatch.syspath_prepend(str(site))
    return site


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "own"
    made.mkdir()
    return made


@pytest.mark.usefixtures("outsider")
def test_finds_installed_patterns_of_any_package() -> None:
    drive = plugins.find_pattern("drive", None)
    assert drive.value == "swarmd.patterns.drive.pattern:Drive"
    assert drive.source.startswith("swarmd ")
    swirl = plugins.Origin("outsider_ok:Swirl", "outsider 2.1")
    assert plugins.find_pattern("swirl", None) == swirl


def test_metadata_is_read_once_until_a_package_is_installed(
    outsider: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry_points, reads = metadata.entry_points, list[str]()

    def read(*, group: str) -> metadata.EntryPoints:
        reads.append(group)
        return entry_points(group=group)

    monkeypatch.setattr(metadata, "entry_points", read)
    # Without the checkout, in whose folder another process may make a file.
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(ROOT)])

    def reads_of(count: int) -> int:
        before = len(reads)
        assert [plugins.find_pattern("swirl", None).source for _ in range(count)]
        return len(reads) - before

    monkeypatch.setattr(plugins, "SETTLED", 1 << 62)
    assert reads_of(3) == 3  # a folder has just changed: a package may be incomplete
    monkeypatch.setattr(plugins, "SETTLED", 0)
    assert reads_of(3) == 1
    (outsider / "outsider-2.1.dist-info").rename(outsider / "outsider-2.2.dist-info")
    metadata_file = outsider / "outsider-2.2.dist-info" / "METADATA"
    metadata_file.write_text(metadata_file.read_text().replace("2.1\n", "2.2\n", 2))
    os.utime(outsider, ns=(1, 1))
    assert plugins.find_pattern("swirl", None).source == "outsider 2.2"


def test_finds_patterns_in_the_plugin_folder_and_ignores_other_files(folder: Path) -> None:
    for name in ("spin.py", "test_spin.py", "_hidden.py", "Big.py", "notes.txt", "swarm.yaml"):
        (folder / name).touch()
    (folder / "folder.py").mkdir()
    (folder / "survey.yaml").write_text("# by night\nmission: Goes round\n")
    found = plugins.pattern_names(folder).items() - plugins.installed_patterns().items()
    assert sorted(name for name, origin in found if origin.is_file) == ["spin", "survey"]
    spin = plugins.find_pattern("spin", folder)
    assert spin.value == str((folder / "spin.py").resolve())
    assert spin.source == str(folder / "spin.py")


def test_only_regular_files_are_read(folder: Path) -> None:
    os.mkfifo(folder / "pipe.yaml")
    (folder / "dir.yaml").mkdir()
    (folder / "nowhere.yaml").symlink_to(folder / "nothing")
    with (folder / "big.yaml").open("wb") as file:
        file.truncate(1 << 36)  # 64 GB of zeros that no disk holds
    assert [name for name, one in plugins.pattern_names(folder, {}).items() if one.is_file] == []


def test_two_patterns_of_one_name_are_listed_and_refused(folder: Path) -> None:
    (folder / "drive.py").touch()
    assert plugins.pattern_names(folder)["drive"].rival == str(folder / "drive.py")
    with pytest.raises(PluginError, match=r"'drive': swarmd .* and "):
        plugins.find_pattern("drive", folder)


@pytest.mark.parametrize(
    ("name", "place", "subject"),
    [("driv", ".", "'driv'.*'drive'"), ("Big", ".", r"Big\.py"), ("drive", "none", "own/none")],
)
def test_a_pattern_that_cannot_be_found_is_refused(
    folder: Path, name: str, place: str, subject: str
) -> None:
    (folder / "Big.py").touch()
    with pytest.raises(PluginError, match=subject):
        plugins.find_pattern(name, folder / place)


@pytest.mark.usefixtures("outsider")
def test_loads_a_driver_and_a_verb() -> None:
    import outsider_ok  # type: ignore[import-not-found]  # made by the fixture

    assert plugins.load_driver("kit") is outsider_ok.Kit
    assert plugins.load_command("wave") is outsider_ok.wave
    assert "wave" in plugins.command_names()


@pytest.mark.usefixtures("outsider")
@pytest.mark.parametrize(
    ("verb", "summary"),
    [
        ("deep", "Dives."),
        ("wave", "Comes with outsider 2.1."),  # its source has no function of that name
        ("demo", "Start a simulated swarm, run one pattern or SCENARIO, and print a summary."),
    ],
)
def test_a_verb_is_summed_up_without_importing_it(verb: str, summary: str) -> None:
    before = set(sys.modules)
    assert plugins.command_summary(plugins.command_names()[verb]) == summary
    assert not {name for name in sys.modules.keys() - before if "sim" in name or "outs" in name}


def test_lines_of_verbs_are_kept_until_a_source_changes(
    outsider: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    first = plugins.command_summaries()
    assert first["deep"] == "Dives."
    with monkeypatch.context() as patch:
        patch.setattr(plugins, "command_names", lambda: pytest.fail("the metadata was read"))
        assert plugins.command_summaries() == first
    (source,) = (file for file in outsider.rglob("*.py") if "Dives." in file.read_text())
    source.write_text(source.read_text().replace("Dives.", "Swims."))
    os.utime(source, ns=(1, 1))
    assert plugins.command_summaries()["deep"] == "Swims."


@pytest.mark.parametrize("content", [b"", b"[]", b"{}", b"\xff", b'{"times": {}, "sources": [1]}'])
def test_a_bad_file_of_lines_of_verbs_is_made_again(
    content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = plugins.command_summaries()
    (file,) = (tmp_path / "swarmd").iterdir()
    good = file.read_bytes()
    file.write_bytes(content)
    assert plugins.command_summaries() == first
    assert file.read_bytes() == good
    file.unlink()
    os.mkfifo(file)  # without a writer, which a plain `open` would wait for
    assert plugins.command_summaries() == first
    assert file.read_bytes() == good


@pytest.mark.usefixtures("outsider")
@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("kitt", r"no driver 'kitt'.*'kit'"),
        (
            "needy",
            r"'needy' needs absent, .*pip install 'outsider\[far\]'",
        ),
        ("lost", r"driver 'lost' of outsider 2\.1 .*'outsider_ok'"),
        ("broken", r"driver 'broken' of outsider 2\.1"),
        ("gone", r"driver 'gone' of outsider 2\.1 .*'outsider_gone'"),
    ],
)
def test_a_driver_that_cannot_be_loaded_is_refused_in_one_line(name: str, fault: str) -> None:
    with pytest.raises(PluginError, match=f"^{fault}") as caught:
        plugins.load_driver(name)
    assert "\n" not in str(caught.value)


def test_a_module_of_no_extra_is_named_itself() -> None:
    assert plugins.how_to_install("scapy", "sim").endswith("run: pip install scapy")


@pytest.mark.integration
def test_discovery_imports_no_pattern() -> None:
    code = (
        "import sys; from swarmd.plugins import pattern_names; pattern_names(None);"
        "sys.exit(any(m.startswith('swarmd.patterns') or m == 'numpy' for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
