"""Contact episodes: one for each touch, however many steps it lasts."""

from __future__ import annotations

from swarmd.sim.world.contacts import EPISODE_GAP, ContactEpisodes


def test_a_lasting_touch_of_a_pair_counts_once_and_a_later_one_again() -> None:
    episodes = ContactEpisodes()
    begun = [episodes.add(t, "b", "a") for t in (0.0, 0.01, EPISODE_GAP, 2.0 * EPISODE_GAP)]
    assert begun == [True, False, False, False]
    assert episodes.add(2.1 * EPISODE_GAP, "a", "wall/east")
    assert episodes.add(3.1 * EPISODE_GAP, "a", "b")
    assert episodes.counts == {("a", "b"): 2, ("a", "wall/east"): 1}
