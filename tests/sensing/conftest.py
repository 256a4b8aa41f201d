"""Tests of this folder run with numpy and with the compiled kernel."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from swarmd.core.kernels import load_kernel
from swarmd.sensing import conditioning, conditioning_numpy, rays, rays_numpy


@pytest.fixture(scope="module", params=["numpy", "compiled"], autouse=True)
def path(request: pytest.FixtureRequest) -> Iterator[None]:
    kernel = None
    if request.param == "compiled":
        kernel = load_kernel("swarmd.sensing.scan_kernel")
        if kernel is None:
            pytest.skip("scan_kernel was not built; `make kernels` builds it")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rays, "_features", kernel or rays_numpy)
        patch.setattr(conditioning, "_rays", kernel or conditioning_numpy)
        yield
