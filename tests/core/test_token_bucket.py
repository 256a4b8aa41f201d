from __future__ import annotations

from swarmd.core.token_bucket import TokenBucket


def test_a_burst_passes_at_once_and_the_rest_at_the_rate() -> None:
    bucket = TokenBucket(rate=10.0, burst=5.0)
    assert sum(bucket.take(1.0, 1e5) for _ in range(20)) == 5
    passed = sum(bucket.take(1.0, 1e5 + 0.01 * n) for n in range(1, 201))
    assert passed in (19, 20)


def test_what_does_not_fit_takes_nothing() -> None:
    bucket = TokenBucket(rate=1.0, burst=5.0)
    assert not bucket.take(6.0, 1.0)
    assert bucket.take(5.0, 1.0)


def test_a_clock_that_goes_back_gives_nothing() -> None:
    bucket = TokenBucket(rate=1.0, burst=1.0)
    assert bucket.take(1.0, 100.0)
    assert not bucket.take(1.0, 0.0)
    assert bucket.take(1.0, 1.1)
