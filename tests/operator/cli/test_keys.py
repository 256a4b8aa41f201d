"""`swarmctl keys` and `swarmd install`, in a home and a root of the test."""

from __future__ import annotations

import json
import shutil
import stat
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner, Result

from swarmd.core.errors import ConfigError
from swarmd.core.finding import Level
from swarmd.link.keys.identity import find_identity, load_identity
from swarmd.link.keys.roster import Role
from swarmd.operator.cli.daemon import swarmd
from swarmd.operator.cli.swarmctl import cli
from swarmd.operator.session.exit_codes import NO_TARGET
from swarmd.operator.verbs.doctor.command import _of_daemon_file
from swarmd.settings.contexts import context_in_use
from swarmd.settings.settings import load_daemon_settings

Run = Callable[..., Result]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home of the test, which is the working directory, too."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("XDG_CONFIG_HOME", "SWARM", "SWARM_CONFIG", "SWARM_CONTEXT", "SWARMD_PASSPHRASE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def keys(home: Path) -> Run:
    def run(*words: str) -> Result:
        return CliRunner().invoke(cli, ["keys", *words], catch_exceptions=True)

    return run


@pytest.fixture
def meadow(keys: Run) -> Run:
    """A swarm of three robots, two operators and a viewer, with its bundles in `b`."""
    options = ["--operators", "alice,bob", "--viewers", "class", "--interface", "wlan0"]
    assert keys("init", "meadow", "--robots", "tb3-[01-03]", *options).exit_code == 0
    assert keys("bundle", "--all", "-o", "b").exit_code == 0
    return keys


def install(*words: str) -> Result:
    return CliRunner().invoke(swarmd, ["install", *words])


def is_refused(done: Result) -> bool:
    return isinstance(done.exception, ConfigError)


def tree(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_init_makes_a_private_authority_and_the_identity_of_the_first_operator(
    meadow: Run, home: Path
) -> None:
    identity = find_identity("meadow")
    assert identity is not None
    assert (identity.name, len(identity.roster.robots)) == ("alice", 3)
    for path in (home / ".config/swarmd").rglob("*"):
        if path.name != "contexts.yaml":
            assert stat.S_IMODE(path.stat().st_mode) & 0o077 == 0 or path.name == "identities"
    chosen = context_in_use()
    assert chosen is not None
    assert chosen[1].swarm == "meadow"
    assert yaml.safe_load(Path(str(chosen[1].config)).read_text())["interface"] == "wlan0"


@pytest.mark.parametrize(
    "words",
    [
        ("meadow", "--robots", "tb3-["),
        ("meadow", "--robots", "a", "--operators", "a"),
        ("Meadow", "--robots", "a"),
        ("meadow", "--robots", "a", "--profile", "field"),
        ("default", "--robots", "a", "--interface", "wlan0"),
        ("meadow", "--robots", "a", "--seed", "nowhere"),
        ("meadow", "--robots", "a", "--config", "swarm.yaml"),
    ],
)
def test_a_mistake_in_init_leaves_nothing_behind(
    keys: Run, home: Path, words: tuple[str, ...]
) -> None:
    (home / "swarm.yaml").write_text("labels: {red: [x]\n")
    before = tree(home)
    assert is_refused(keys("init", *words))
    assert tree(home) == before


def test_a_second_init_is_refused(meadow: Run, home: Path) -> None:
    before = tree(home)
    assert is_refused(meadow("init", "meadow", "--robots", "x"))
    assert tree(home) == before


def test_bundles_have_the_settings_beside_the_authority(keys: Run, home: Path) -> None:
    (home / "s.yaml").write_text("lease: 5.0\nlabels: {red: [r1]}\nroster: [r1, r2]\n")
    assert keys("init", "lab", "--robots", "r[1-2]", "--config", "s.yaml").exit_code == 0
    assert keys("bundle", "r1", "-o", "one.bundle").exit_code == 0
    (home / "root").mkdir()
    done = install("one.bundle", "--root", "root")
    assert done.exit_code == 0
    assert "no platform and no driver" in done.stdout
    config = home / "root/etc/swarmd/swarmd.yaml"
    assert yaml.safe_load(config.read_text()) == {
        "id": "r1",
        "swarm": "lab",
        "lease": 5.0,
        "labels": {"red": ["r1"]},
    }
    folder = home / "root/etc/swarmd/identities/lab"
    settings = load_daemon_settings(config, {"identity": str(folder)})
    assert (settings.id, settings.labels, settings.roster) == ("r1", ("red",), ("r1", "r2"))
    assert settings.identity is not None


def test_a_second_installation_changes_nothing(meadow: Run, home: Path) -> None:
    (home / "root").mkdir()
    words = ("b/tb3-01.bundle", "--root", "root", "--platform", "burger", "--driver", "ros2dds")
    assert install(*words).exit_code == 0
    config = home / "root/etc/swarmd/swarmd.yaml"
    written = yaml.safe_load(config.read_text())
    assert (written["platform"], written["driver"]) == ("burger", "ros2dds")
    before = tree(home / "root")
    for again in (words, words[:3]):  # without the options the file keeps both
        done = install(*again)
        assert done.exit_code == 0
        assert "nothing is changed" in done.stdout
        assert tree(home / "root") == before


@pytest.mark.parametrize("option", ["--platform=waffle_pi", "--driver=rmw_zenoh"])
def test_another_platform_or_driver_asks_for_replace(meadow: Run, home: Path, option: str) -> None:
    (home / "root").mkdir()
    words = ("b/tb3-01.bundle", "--root", "root")
    assert install(*words, "--platform", "burger", "--driver", "ros2dds").exit_code == 0
    before = tree(home / "root")
    refused = install(*words, option)
    assert is_refused(refused)
    assert "--replace" in str(refused.exception)
    assert tree(home / "root") == before
    assert install(*words, option, "--replace").exit_code == 0
    key, _, value = option.removeprefix("--").partition("=")
    settings = yaml.safe_load((home / "root/etc/swarmd/swarmd.yaml").read_text())
    assert settings == {**settings, "platform": "burger", "driver": "ros2dds", key: value}


def test_a_key_that_stands_twice_is_named_with_both_lines(meadow: Run, home: Path) -> None:
    (home / "root").mkdir()
    words = ("b/tb3-01.bundle", "--root", "root")
    assert install(*words, "--platform", "burger").exit_code == 0
    config = home / "root/etc/swarmd/swarmd.yaml"
    lines = config.read_text().splitlines()
    first = next(at for at, line in enumerate(lines, 1) if line.startswith("platform:"))
    config.write_text("\n".join([*lines, "platform: burger", ""]))
    before = tree(home / "root")
    (fault,) = _of_daemon_file(config)
    for text in (fault.text, str(install(*words).exception)):
        assert f"swarmd.yaml:{len(lines) + 1}: " in text
        assert f"line {first}" in text
    assert fault.level is Level.FAULT
    checked = CliRunner().invoke(swarmd, ["--config", str(config), "--check"])
    assert f"line {first}" in str(checked.exception)
    assert tree(home / "root") == before


def test_list_has_names_roles_ends_and_generations(keys: Run, home: Path) -> None:
    keys("init", "lab", "--robots", "r[1-2]", "--operators", "alice", "--days", "10")
    keys("bundle", "r1")
    listed = json.loads(keys("list", "-o", "json").stdout)
    rows = {row["name"]: row for row in listed["names"]}
    assert {name: row["role"] for name, row in rows.items()} == {
        "r1": "robot",
        "r2": "robot",
        "alice": "operator",
    }
    assert (rows["r1"]["days"], rows["r1"]["generation"], rows["r1"]["is_bundled"]) == (9, 2, True)
    assert (rows["r2"]["days"], rows["r2"]["is_bundled"]) == (None, False)
    table = keys("list").stdout
    assert "r1: the certificate ends in 9 days" in table


def test_a_passphrase_is_asked_for_only_where_the_authority_has_one(
    keys: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert is_refused(keys("init", "lab", "--robots", "r1", "--passphrase"))  # no terminal
    monkeypatch.setenv("SWARMD_PASSPHRASE", "word")
    assert keys("init", "lab", "--robots", "r1", "--passphrase").exit_code == 0
    assert keys("bundle", "r1").exit_code == 0
    monkeypatch.setenv("SWARMD_PASSPHRASE", "other")
    assert is_refused(keys("bundle", "r1"))
    monkeypatch.delenv("SWARMD_PASSPHRASE")
    assert is_refused(keys("list"))


def test_install_keeps_what_belongs_to_the_robot(meadow: Run, home: Path) -> None:
    config = home / "root/etc/swarmd/swarmd.yaml"
    config.parent.mkdir(parents=True)
    own = {"platform": "burger", "driver": "simulated", "interface": "wlp2s0"}
    config.write_text(yaml.safe_dump({**own, "seeds": ["tcp/10.0.0.9:7440"], "insecure": True}))
    assert install("b/tb3-01.bundle", "--root", "root").exit_code == 0
    expected = {"id": "tb3-01", "swarm": "meadow", "profile": "field", **own}
    assert yaml.safe_load(config.read_text()) == expected
    assert install("b/tb3-01.bundle", "--root", "root", "--interface", "wlan1").exit_code == 0
    assert yaml.safe_load(config.read_text()) == {**expected, "interface": "wlan1"}


def test_install_refuses_what_does_not_belong_here_and_changes_nothing(
    meadow: Run, home: Path
) -> None:
    (home / "root").mkdir()
    assert install("b/tb3-01.bundle", "--root", "root").exit_code == 0
    shutil.move(home / ".config", home / "first")
    meadow("init", "meadow", "--robots", "tb3-[01-03]")
    meadow("bundle", "tb3-01", "-o", "foreign.bundle")
    shutil.rmtree(home / ".config")
    shutil.move(home / "first", home / ".config")
    (home / "cut.bundle").write_bytes((home / "b/tb3-01.bundle").read_bytes()[:-1])
    before = tree(home)
    for words in (
        ("b/tb3-02.bundle", "--root", "root"),
        ("b/alice.bundle", "--root", "root"),
        ("b/alice.bundle", "--root", "root", "--force"),
        ("foreign.bundle", "--root", "root"),
        ("cut.bundle", "--root", "root", "--force"),
        ("absent.bundle", "--root", "root"),
        ("b/tb3-01.bundle", "--root", "nowhere"),
    ):
        assert is_refused(install(*words)), words
    assert tree(home) == before
    for file, name in (("b/tb3-02.bundle", "tb3-02"), ("foreign.bundle", "tb3-01")):
        assert install(file, "--root", "root", "--force").exit_code == 0
        assert load_identity(home / "root/etc/swarmd/identities/meadow").name == name


def test_an_older_roster_is_refused_also_by_force(meadow: Run, home: Path) -> None:
    (home / "root").mkdir()
    meadow("add", "tb3-04", "--timeout", "0.1s")
    meadow("bundle", "tb3-01", "-o", "new.bundle")
    assert install("new.bundle", "--root", "root").exit_code == 0
    before = tree(home / "root")
    for words in ((), ("--force",)):
        assert is_refused(install("b/tb3-01.bundle", "--root", "root", *words))
    assert tree(home / "root") == before


def test_a_disk_that_fails_leaves_the_old_installation(
    meadow: Run, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (home / "root").mkdir()
    assert install("b/tb3-01.bundle", "--root", "root").exit_code == 0
    before = tree(home / "root")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device", "swarmd.yaml")

    monkeypatch.setattr("swarmd.settings.installed.write_yaml", fail)
    assert isinstance(install("b/tb3-02.bundle", "--root", "root", "--force").exception, OSError)
    after = tree(home / "root")
    assert {name: after[name] for name in before} == before


def test_operators_and_viewers_install_for_themselves(meadow: Run, home: Path) -> None:
    assert is_refused(meadow("install", "b/bob.bundle"))  # this user is alice
    assert meadow("install", "b/bob.bundle", "--force").exit_code == 0
    assert is_refused(meadow("install", "b/tb3-01.bundle", "--force"))
    identity = find_identity("meadow")
    assert identity is not None
    assert identity.name == "bob"


def test_a_revoked_operator_rolls_out_no_roster(meadow: Run) -> None:
    assert meadow("install", "b/bob.bundle", "--force").exit_code == 0
    meadow("revoke", "alice", "--timeout", "0.1s")  # there is no such interface: no robot hears it
    assert meadow("install", "b/alice.bundle", "--force").exit_code == 0
    done = meadow("push")
    assert done.exit_code == NO_TARGET
    assert "alice (this user) is no operator on generation 3" in done.output


def test_the_last_operator_and_the_last_robot_stay(meadow: Run, home: Path) -> None:
    before = tree(home)
    for words in (("alice", "bob"), ("tb3-*",), ("nobody",)):
        assert is_refused(meadow("revoke", *words))
    assert is_refused(meadow("revoke", "alice"))  # this user, who could roll out no roster then
    assert is_refused(meadow("add", "tb3-01", "--role", "viewer"))
    for name in ("bo", "tb4-01", "tb3-", "3", "tb3-0x"):
        done = meadow("add", name)
        assert is_refused(done)
        assert "--role" in str(done.exception)
    assert tree(home) == before


def test_issue_writes_a_bundle_with_a_permit_that_list_shows(keys: Run, home: Path) -> None:
    assert keys("init", "meadow", "--robots", "tb3-[01-03]").exit_code == 0
    may = ("--may", "stop", "--may", "run  attraction", "--may", "param attraction.*")
    bounds = ("--robots", "tb3-0[1-2]", "--for", "60s", "--speed", "0.15", "--lasts", "10m")
    issued = keys("issue", "anna,ben", "--role", "pupils", *may, *bounds)
    assert issued.exit_code == NO_TARGET  # no robot has a bundle that could take the roster

    rows = {row["name"]: row for row in json.loads(keys("list", "-o", "json").stdout)["names"]}
    for name in ("anna", "ben"):
        assert rows[name]["role"] == "permit"
        assert rows[name]["permit"]["role"] == "pupils"
        for part in ("run attraction", "param attraction.*", "tb3-0[1-2]", "60 s", "0.15 m/s"):
            assert part in rows[name]["permit"]["may"]
    assert rows["tb3-01"]["permit"] is None
    assert "anna (pupils) may stop" in keys("list").stdout

    assert keys("install", "anna.bundle", "--force").exit_code == 0
    identity = find_identity("meadow")
    assert identity is not None
    permit = identity.roster.permits["anna"]
    assert (identity.role, identity.info.expires) == (Role.PERMIT, permit.until)
    assert abs(permit.until - time.time() - 600.0) < 100.0


@pytest.mark.parametrize(
    "words",
    [
        ("alice", "--may", "stop"),  # an operator
        ("tb3-01", "--may", "stop"),
        ("anna", "--may", "reset"),
        ("anna", "--may", "stop", "--robots", "tb4-*"),
        ("anna", "--may", "run attraction"),  # and may not stop
        ("anna", "--may", "stop", "--role", "Pupils"),
    ],
)
def test_a_mistake_in_issue_changes_no_roster(
    keys: Run, home: Path, words: tuple[str, ...]
) -> None:
    assert keys("init", "meadow", "--robots", "tb3-01", "--operators", "alice").exit_code == 0
    before = keys("list", "-o", "json").stdout
    assert is_refused(keys("issue", *words))
    assert keys("list", "-o", "json").stdout == before
    assert not list(home.glob("*.bundle"))


def test_a_permit_is_no_role_of_add(meadow: Run) -> None:
    assert meadow("add", "anna", "--role", "permit").exit_code == 2
