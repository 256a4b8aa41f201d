"""Which code decides: `import` gives compiled kernels, or their files as CPython runs them."""

from __future__ import annotations

import hashlib
import inspect
import pickle
import shutil
import subprocess
import sys
import traceback
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
from msgspec.structs import replace

from swarmd.core import kernels
from swarmd.core.codec import Decoder, encode
from swarmd.core.kernels import (
    HELPERS,
    KERNELS,
    LIBRARIES,
    KernelFinder,
    describe_kernels,
    files_of,
    kernels_of,
    source_of,
)
from swarmd.core.messages import Status
from swarmd.kit import points
from swarmd.robot.protection import barrier
from swarmd.robot.protection.stopping import Speeds
from tests.support.fake_daemon import light_status
from tests.support.kernel_forms import both_forms, interpreted_kernels

ROOT = Path(__file__).parents[2]
needs_both = pytest.mark.skipif(describe_kernels() != "compiled", reason="kernels are interpreted")


def test_all_kernels_of_this_suite_have_one_form() -> None:
    """A kernel that is older than its source would be interpreted among compiled ones."""
    without_compiler = "interpreted (SWARMD_COMPILED=0)", "interpreted (not compiled)"
    assert describe_kernels() in ("compiled", *without_compiler), "run `make kernels`"


@needs_both
def test_import_gives_the_compiled_kernel_with_the_file_of_its_source() -> None:
    """Also of each class: memory of recordings, pickle and `inspect` find it by its names."""
    for name in sorted({*KERNELS} - {*HELPERS}):
        module = import_module(name)
        assert KernelFinder.find_spec(name) is not None
        assert Path(str(module.__file__)).resolve() == ROOT / source_of(name)
        for one in vars(module).values():
            if isinstance(one, type) and one.__module__ in KERNELS:
                home = import_module(one.__module__)
                assert getattr(home, one.__name__) is one
                assert inspect.getmodule(one) is home
    assert hasattr(barrier, "__unit__")
    assert "class Barrier" in inspect.getsource(barrier.Barrier)


def test_a_traceback_names_the_line_of_the_source() -> None:
    with pytest.raises(AttributeError) as raised:
        barrier.Barrier(None)  # type: ignore[arg-type]
    *_, last = traceback.extract_tb(raised.value.__traceback__)
    assert last.filename.endswith("swarmd/robot/protection/barrier.py")
    line = (
        (ROOT / "swarmd/robot/protection/barrier.py")
        .read_text()
        .splitlines()[int(last.lineno or 0) - 1]
    )
    assert "platform.protection" in line


@needs_both
def test_both_forms_stand_under_one_name() -> None:
    text, used = both_forms("swarmd.kit.points")
    assert text.polar_from_base is not used.polar_from_base
    with interpreted_kernels():
        from swarmd.kit import points as inside  # that of this block

        assert import_module("swarmd.kit.points") is inside
        assert inside.polar_from_base is text.polar_from_base
    assert import_module("swarmd.kit.points") is points
    from swarmd.kit import points as after  # that of the package

    assert after is points
    assert points.polar_from_base is used.polar_from_base


@needs_both
def test_an_object_of_a_kernel_can_be_pickled() -> None:
    speeds = Speeds()
    assert type(pickle.loads(pickle.dumps(speeds))) is Speeds


def test_no_library_is_loaded_where_it_is_not_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SWARMD_COMPILED", "0")
    assert [KernelFinder.find_spec(name) for name in KERNELS] == [None] * len(KERNELS)
    assert describe_kernels() == "interpreted (SWARMD_COMPILED=0)"


def test_a_kernel_that_was_not_built_is_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    absent = {"swarmd.core._absent": {"swarmd.core._clock": ("swarmd.core.clock",)}}
    monkeypatch.setattr(kernels, "LIBRARIES", absent)
    monkeypatch.setattr(kernels, "_UNIT_OF", {"swarmd.core.clock": "swarmd.core._clock"})
    monkeypatch.setattr(kernels, "_LIBRARY_OF", {"swarmd.core._clock": "swarmd.core._absent"})
    assert KernelFinder.find_spec("swarmd.core.clock") is None
    assert describe_kernels() == "interpreted (not compiled)"
    monkeypatch.setattr(kernels, "LIBRARIES", {**LIBRARIES, **absent})
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
        "from swarmd.core.kernels import KERNELS, UNITS;"
        "print({*KERNELS, *UNITS, 'numpy'} & {*sys.modules})"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.integration
def test_protection_maps_no_library_of_what_is_led(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    _library("swarmd._trusted")
    script = (
        "from pathlib import Path;"
        "from swarmd.robot.protection.fence.fence_settings import FenceSettings;"
        "from swarmd.robot.protection.fence.fence_pose import FencePose;"
        "from swarmd.settings.platforms import load_platform;"
        "import swarmd.robot.robot;"
        "from swarmd.robot.protection.protection import Protection;"
        "fence = FenceSettings(frame='map', polygon=[(0, 0), (4, 0), (4, 4)]);"
        "made = Protection(load_platform('waffle_pi'), [fence]), FencePose(fence, 1.0);"
        "print(*{Path(line.split()[-1]).name.split('.')[0]"
        " for line in Path('/proc/self/maps').read_text().splitlines() if '/swarmd/' in line})"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)

    mapped = {*done.stdout.split()}
    assert mapped == {"_trusted", "_views"}


@pytest.mark.integration
@pytest.mark.parametrize("share", [0.0, 0.00002, 0.003, 0.3, 0.999])
def test_a_kernel_that_was_cut_off_is_not_loaded_and_named(
    share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    whole = _library("swarmd._trusted").read_bytes()
    (tmp_path / "_cut.abi3.so").write_bytes(whole[: int(share * len(whole))])
    assert _said_of_cut_kernel(tmp_path) == "[None] interpreted (not compiled)"


@pytest.mark.integration
@pytest.mark.parametrize("share", [0.01, 0.5, 0.99])
def test_a_kernel_that_ends_in_zeros_is_not_loaded_and_named(
    share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a loss of power leaves it: the file has its length, and its last pages were not written.

    The linker of C ends the process if it opens such a file.
    """
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    whole = _library("swarmd._trusted").read_bytes()
    written = whole[: int(share * len(whole))]
    (tmp_path / "_cut.abi3.so").write_bytes(written.ljust(len(whole), b"\0"))
    assert _said_of_cut_kernel(tmp_path) == "[None] interpreted (not compiled)"


def test_a_library_in_a_package_that_is_not_here_is_not_compiled() -> None:
    assert kernels._file("swarmd.absent._absent") is None


@pytest.mark.integration
def test_a_kernel_of_another_processor_is_not_loaded_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    foreign = bytearray(_library("swarmd._trusted").read_bytes())
    foreign[18:20] = b"\xff\x7f"  # e_machine
    (tmp_path / "_cut.abi3.so").write_bytes(foreign)
    assert _said_of_cut_kernel(tmp_path) == "[None] interpreted (not compiled)"


@pytest.mark.integration
@pytest.mark.parametrize("library", ["swarmd.sim._world", "swarmd._led"])
def test_a_library_that_is_older_than_a_source_is_not_loaded_and_named_once(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWARMD_COMPILED", raising=False)
    package, _, name = library.rpartition(".")
    shutil.copy(_library(library), tmp_path)
    kernels_in = tuple(kernel.removeprefix(f"{package}.") for kernel in kernels_of(library))
    sources = [ROOT / file for kernel in kernels_of(library) for file in files_of(kernel)]
    bases = [tmp_path / one.replace(".", "/") for one in kernels_in]
    copies = [base.with_suffix(suffix) for base in bases for suffix in (".py", ".pxd")]
    pairs = [pair for pair in zip(sources, copies, strict=True) if pair[0].exists()]
    script = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from swarmd.core import kernels;"
        f"kernels.LIBRARIES = {{{name!r}: {{'unit': {kernels_in}}}}};"
        f"kernels._UNIT_OF = {{'kernel': 'unit'}}; kernels._LIBRARY_OF = {{'unit': {name!r}}};"
        "print([kernels.KernelFinder.find_spec('kernel') is not None for _ in range(2)],"
        " kernels.describe_kernels())"
    )

    def answer() -> tuple[str, str]:
        command = [sys.executable, "-c", script]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return done.stdout.strip(), done.stderr.strip()

    loaded = ("[True, True] compiled", "")
    assert answer() == loaded, "without a source"
    for source, copy in pairs:
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(source.read_bytes())
    assert answer() == loaded
    text = "older than its source (run make kernels)"
    stale = f"[False, False] interpreted ({text})", f"kernel {name[1:]} is {text}"
    for source, copy in pairs:
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
    _library("swarmd._trusted")
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
        "print([kernels.KernelFinder.find_spec(name) for name in kernels.KERNELS],"
        " kernels.describe_kernels())"
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
        "kernels.LIBRARIES = {'_cut': {'unit': ('cut',)}};"
        "kernels._UNIT_OF = {'cut': 'unit'}; kernels._LIBRARY_OF = {'unit': '_cut'};"
        "said = kernels.describe_kernels();"
        "print([kernels.KernelFinder.find_spec('cut')], said)"
    )
    command = [sys.executable, "-c", script]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
