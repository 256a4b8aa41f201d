"""What a daemon says before it runs."""

from __future__ import annotations

from unittest import mock

import pytest

from swarmd.core.errors import ConfigError
from swarmd.daemon.daemon import serve


async def test_an_error_of_the_settings_comes_without_a_warning_before_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    here = "swarmd.daemon.daemon"
    monkeypatch.setattr(f"{here}.make_driver", lambda settings: mock.Mock(is_simulated=False))
    monkeypatch.setattr(f"{here}.ask_for_slices", lambda seconds: None)
    monkeypatch.setattr(f"{here}.check_protected", mock.Mock(side_effect=ConfigError))
    settings = mock.Mock()
    settings.network.profile = "dev"
    with pytest.raises(ConfigError):
        await serve(settings)
    assert caplog.records == []
