"""Tests of this folder run with numpy and with the compiled kernel."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from swarmd.sensing import rays, rays_numpy


@pytest.fixture(scope="module", params=["numpy", "compiled"], autouse=True)
def path(request: pytest.FixtureRequest) -> Iterator[None]:
    if request.param == "compiled" and rays._features is rays_numpy:
        pytest.skip("scan_kernel was not built; `make kernels` builds it")
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "numpy":
            patch.setenv("SWARMD_COMPILED", "0")
            patch.setattr(rays, "_features", rays_numpy)
        yield
