"""The numbers of right of way, in one place. No user sets them, and nothing changes them.

A comment tells which measurement set a number. A number without one was chosen by hand and works
with the others; no sweep has varied it alone, so that a better value may exist.

The figures of one number or of a few are those of the commit that brought them, on doors of two
bodies with eight robots; later parts have moved the totals.

A kernel (see `core/kernels.py`), compiled into one unit with right_of_way.py, so that a number
is read as a field of C.
"""

from __future__ import annotations

from swarmd.core import cython_shadow as cython


@cython.dataclasses.dataclass(repr=False, eq=False)  # type: ignore[attr-defined]  # no stub
@cython.cclass
class WaySettings:
    """The numbers of right of way. Distances along an axis count from the begin of the opening."""

    # rad/s: scans during a faster turn are not exact enough to show openings
    turning: float = 0.6

    # Which opening is on the way of a request.
    # m before an opening within which a robot that drives to it gives way
    max_ahead: float = 1.6
    # m before an opening beyond which the robot does not give way
    too_far: float = 2.0
    # m before a wall at which a robot turns to its opening
    wall_distance: float = 0.5
    # rad between a request and the wall within which the request leads along it
    along_wall: float = 0.2
    # Cosine of the angle between the request and the way through an opening: below it, the request
    # leads away from the opening.
    leads_away: float = -0.25
    # rad: a request farther to the side is taken for a turn
    sideways: float = 1.3
    # rad from straight back within which a turn keeps the direction behind the robot
    reversed: float = 0.5
    # s after which the robot ignores an opening that it has not passed
    give_up: float = 240.0
    # s of a requested turn that are looked ahead: for a base without an angular limit, and the
    # bounds for any other
    lead: float = 0.1
    least_lead: float = 0.05
    most_lead: float = 0.3

    # Where the robot is.
    # m before an opening from which an aligned robot counts as in the opening
    in_before: float = 0.25
    # m before an opening from which a robot of any heading counts as in the opening
    in_anyhow: float = 0.05
    # m beside an opening beyond which a robot is not in the opening
    in_beside: float = 0.05
    # rad, and share of the half width, of an aligned robot
    aligned: float = 0.5
    aligned_share: float = 0.25
    # m beyond an opening at which the opening is passed
    beyond: float = 0.35

    # What the tracks (other moving objects that the lidar shows) do.
    # s after which a track is no part of a wall
    persists: float = 1.0
    # m before and beyond an opening within which tracks count
    before: float = 0.9
    after: float = 0.5
    # m by which a track in and before an opening may be off its axis
    narrower: float = 0.06
    wider: float = 0.2
    # m before an opening from which a track beside it is a part of the wall: the end of a wall that
    # is seen along its face is a track that stands. Measured: without it a robot waited 140 s for
    # such a track.
    in_wall: float = 0.05
    # m around an opening: a track there keeps the side from which it came
    threshold: float = 0.3
    # m along the axis: a new track before this place comes from the robot's side
    first_seen_in: float = -0.1
    # m back from its farthest place: the track comes out again
    backs_out: float = 0.1
    # m, in addition to the depth, within which a robot in the opening meets a track that comes.
    # Measured with `lean` (below): 44 of 80 robots arrive in place of 38.
    meeting: float = 0.8
    # m to another robot that goes in, and m beyond the opening, within which the robot waits behind
    # it. Measured: with this distance and the middle by the posts (below), approaches overlap: one
    # passage takes 14.5 s in place of 16.8, and 47 of 64 robots pass a door within 200 s in place
    # of 36.
    follow: float = 0.27
    follow_beyond: float = 0.2
    # m around the begin of an opening within which another robot on the same side waits for its
    # turn
    queue_near: float = 0.1
    queue_far: float = 1.6

    # How long the robot waits.
    # s for which nothing has come out before a robot enters; drawn between both
    least_clear: float = 0.5
    most_clear: float = 1.5
    # s for which a robot that was last seen in an opening may still be there
    hidden: float = 6.0
    # s for which a robot gives way again, drawn between both, if it has passed an opening within
    # the last `recently` s
    least_passed: float = 6.0
    most_passed: float = 10.0
    recently: float = 120.0
    # s after a passage in which the robot lets robots pass that wait on its side
    lets_pass: float = 90.0
    # s and m: with less a robot in an opening tries the other way
    stuck: float = 6.0
    progress: float = 0.03

    # How the robot drives.
    # m before an opening, where a robot turns into its axis
    line_up: float = 0.5
    # m before that place within which a robot is at it
    nearly_lined_up: float = 0.1
    # m from that place within which a robot is lined up
    at_line_up: float = 0.08
    # A robot this near to the axis (m), farther than this before the opening (m), is lined up, too.
    on_axis: float = 0.04
    on_axis_far: float = 0.4
    # A robot this far off the axis (m), farther than this before the opening (m), is lined up no
    # more.
    off_axis: float = 0.12
    off_axis_near: float = 0.35
    # of the half width: the same bound nearer to the opening
    off_axis_share: float = 0.25
    # m ahead on the axis: the place to which a robot drives (pure pursuit)
    pursuit: float = 0.15
    # m beside and before an opening that a robot leaves free for others
    beside: float = 0.5
    free: float = 1.4
    # m beside that, to which the robot drives
    farther_beside: float = 0.15
    # m before an opening at least, and m back, where a robot clears the way
    aside_far: float = 0.4
    aside_step: float = 0.1
    # rad within which a waiting robot faces the place where it will line up
    faces: float = 0.2
    # rad/s, of its turn to that place: below `turning`
    facing: float = 0.5
    # m beside the axis: keeps, and chooses, the side to wait on
    keeps_side: float = 0.15
    has_side: float = 0.05
    # m behind the robot: the place on the axis to which a robot backs out
    back_aim: float = 0.4
    # rad/s at most, and share of the speed, while backing out
    back_turn: float = 0.3
    back_share: float = 0.5
    # rad: a goal farther to the side is reached backwards
    backs_to: float = 2.0
    # 1/s: rad/s for each rad that the heading is off
    gain: float = 3.0
    # m/s of speed that are worth a change of the turn by 1 rad/s
    turn_cost: float = 0.15
    # of the limit, before a request has shown a speed
    unknown_speed_share: float = 0.5

    # The middle of the opening, as the returns of its posts show it. Measured: the axis of
    # sightings is off by 5 mm, and by up to 20 cm where a sighting took a robot for a post; with 1
    # cm off the middle, protection allows half of the speed between the posts.
    # m: an opening whose middle is farther off is forgotten and looked for anew. Measured: of eight
    # robots 5 pass in the worst seed, and 1 without it, since the robot pushed against a post.
    wrong_by: float = 0.1
    # weight of a new measurement of the axis
    weight: float = 0.03
    # m within which returns are posts, and their gap is the opening
    at_post: float = 0.1
    same_width: float = 0.08
    # m around the robot within which returns are posts
    posts_behind: float = 0.15
    posts_ahead: float = 0.2
    # m beyond an opening at which its posts are not measured
    past_posts: float = 0.05

    # A corridor. A wall whose rays are older may have come nearer since, so that protection leaves
    # less speed beside it. So a robot keeps away from that wall.
    # m: a deeper opening is a corridor
    deep: float = 0.2
    # m to the side for each s by which the rays of one wall are older than those of the other.
    # Measured, in a corridor of 2.5 bodies with two robots against two and without `walls_stand`:
    # 38 of 80 robots arrive in place of 22.
    lean: float = 0.1
    # m before a corridor from which a robot does so
    lean_from: float = 0.15
    # rad: the bearing of the walls beside, and how far around it
    abeam: float = 1.0
    abeam_width: float = 0.6
