"""Which code decides: compiled kernels or their files as CPython runs them."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from msgspec.structs import replace

from swarmd.core import clock, kernels
from swarmd.core.codec import Decoder, encode
from swarmd.core.kernels import KERNELS, LIBRARIES, describe_kernels, load_kernel, source_of
from swarmd.core.messages import Status
from tests.support.fake_daemon import light_status

ROOT = Path(__file__).parents[2]


def test_all_kernels_of_this_suite_have_one_form() -> None:
    """A kernel that is older than its source would be interpreted among compiled ones."""
    without_compiler = "interpreted (SWARMD_COMPILED=0)", "interpreted (not compiled)"
    assert describe_kernels() in ("compiled", *without_compiler), "run `make kernels`"


def test_no_library_is_loaded_where_it_is_not_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SWARMD_COMPILED", "0")
    assert [kernels._compiled(name) for name in KERNELS] == [None] * len(KERNELS)
    assert load_kernel("swarmd.core.clock") is clock
    assert describe_kernels() == "interpreted (SWARMD_COMPILED=0)"


def test_a_kernel_that_was_not_built_is_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    monkeypatch.setattr(kernels, "LIBRARIES", {"swarmd.core._clock": ("swarmd.core.clock",)})
    assert kernels._compiled("swarmd.core.clock") is None
    assert load_kernel("swarmd.core.clock") is clock
    assert describe_kernels() == "interpreted (not compiled)"
    both = {**LIBRARIES, "swarmd.protection._absent": ("swarmd.protection.absent",)}
    monkeypatch.setattr(kernels, "LIBRARIES", both)
    monkeypatch.setattr(kernels, "_fault_of", lambda name: "gone" if "absent" in name else "")
    assert describe_kernels() == "compiled, but absent is gone"


def test_any_text_about_kernels_fits_into_a_status(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    first, *others = LIBRARIES
    monkeypatch.setattr(kernels, "_fault_of", lambda n: "" if n == first else kernels._STALE)
    told = describe_kernels()
    assert all(name.rpartition("._")[2] in told for name in others)
    told_of = replace(light_status("r1", "i1"), kernels=told)
    assert Decoder(Status)(encode(told_of)).kernels == told


@pytest.mark.integration
def test_a_description_imports_no_kernel() -> None:
    script = (
        "import sys; from swarmd.core.kernels import describe_kernels; describe_kernels();"
        "from swarmd.core.kernels import KERNELS, LIBRARIES;"
        "print({*KERNELS, *LIBRARIES, 'numpy'} & {*sys.modules})"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.integration
def test_protection_maps_no_library_of_steering_or_kin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    _library("swarmd.protection._barrier")
    script = (
        "from pathlib import Path; from swarmd.core.kernels import load_kernel;"
        "from swarmd.protection.fence.fence_settings import FenceSettings;"
        "from swarmd.protection.fence.fence_pose import FencePose;"
        "from swarmd.settings.platforms import load_platform;"
        "import swarmd.robot.robot;"
        "Protection = load_kernel('swarmd.protection.protection').Protection;"
        "fence = FenceSettings(frame='map', polygon=[(0, 0), (4, 0), (4, 4)]);"
        "made = Protection(load_platform('waffle_pi'), [fence]), FencePose(fence, 1.0);"
        "print(*{Path(line.split()[-1]).name.split('.')[0]"
        " for line in Path('/proc/self/maps').read_text().splitlines() if '/swarmd/' in line})"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)

    mapped = {*done.stdout.split()}
    assert {"_barrier", "_protection"} <= mapped
    assert not mapped & {"_kin", "_steering", "_points"}


@pytest.mark.integration
@pytest.mark.parametrize("share", [0.0, 0.00002, 0.003, 0.3, 0.999])
def test_a_kernel_that_was_cut_off_is_not_loaded_and_named(
    share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    whole = _library("swarmd.protection._barrier").read_bytes()
    (tmp_path / "_cut.abi3.so").write_bytes(whole[: int(share * len(whole))])
    assert _said_of_cut_kernel(tmp_path) == "None interpreted (not compiled)"


@pytest.mark.integration
def test_a_kernel_of_another_processor_is_not_loaded_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    foreign = bytearray(_library("swarmd.protection._barrier").read_bytes())
    foreign[18:20] = b"\xff\x7f"  # e_machine
    (tmp_path / "_cut.abi3.so").write_bytes(foreign)
    assert _said_of_cut_kernel(tmp_path) == "None interpreted (not compiled)"


@pytest.mark.integration
@pytest.mark.parametrize("library", ["swarmd.sim.world._base", "swarmd.sensing._scans"])
def test_a_library_that_is_older_than_a_source_is_not_loaded_and_named_once(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    package, _, name = library.rpartition(".")
    shutil.copy(_library(library), tmp_path)
    kernels_in = tuple(kernel.removeprefix(f"{package}.") for kernel in LIBRARIES[library])
    sources = [ROOT / source_of(kernel) for kernel in LIBRARIES[library]]
    copies = [tmp_path / f"{one.replace('.', '/')}.py" for one in kernels_in]
    script = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from swarmd.core import kernels;"
        f"kernels.LIBRARIES = {{{name!r}: {kernels_in}}};"
        f"print([kernels._compiled({kernels_in[-1]!r}) is not None for _ in range(2)],"
        " kernels.describe_kernels())"
    )

    def answer() -> tuple[str, str]:
        command = [sys.executable, "-c", script]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return done.stdout.strip(), done.stderr.strip()

    loaded = ("[True, True] compiled", "")
    assert answer() == loaded, "without a source"
    for source, copy in zip(sources, copies, strict=True):
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(source.read_bytes())
    assert answer() == loaded
    text = "older than its source (run make kernels)"
    stale = f"[False, False] interpreted ({text})", f"kernel {name[1:]} is {text}"
    for source, copy in zip(sources, copies, strict=True):
        copy.write_bytes(source.read_bytes() + b"\n")
        assert answer() == stale
        copy.write_bytes(source.read_bytes())


@pytest.mark.integration
@pytest.mark.parametrize(
    ("views", "said"),
    [
        (b"", "interpreted (not compiled)"),
        (b"another version", "interpreted (older than its source (run make kernels))"),
    ],
)
def test_no_kernel_is_loaded_without_the_views_of_its_cython(
    views: bytes, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    _library("swarmd.protection._barrier")
    whole = _library(kernels.VIEWS).read_bytes()
    library = kernels._opened(kernels.VIEWS)
    assert library is not None
    digest = kernels._digest_in(library, "views_digest").encode()
    assert digest in whole
    other = whole.replace(digest, hashlib.sha256(views).hexdigest().encode()) if views else b""
    (tmp_path / "_foreign.abi3.so").write_bytes(other)
    script = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from swarmd.core import kernels;"
        "kernels.VIEWS = '_foreign';"
        "print([kernels._compiled(name) for name in kernels.KERNELS], kernels.describe_kernels())"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"{[None] * len(KERNELS)} {said}"


def _library(name: str) -> Path:
    """The file of a library; the test is skipped without one."""
    spec = find_spec(name)
    if spec is None or not str(spec.origin).endswith(".so"):
        pytest.skip("the kernels are not compiled")
    return Path(str(spec.origin))


def _said_of_cut_kernel(folder: Path) -> str:
    """What a process of its own says of a kernel there: a damaged one may end it."""
    script = (
        f"import sys; sys.path.insert(0, {str(folder)!r}); from swarmd.core import kernels;"
        "kernels.LIBRARIES = {'_cut': ('cut',)};"
        "said = kernels.describe_kernels();"
        "print(kernels._compiled('cut'), said)"
    )
    command = [sys.executable, "-c", script]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
