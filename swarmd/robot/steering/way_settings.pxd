# What C needs of way_settings.py, which has the meaning of each name.

cimport cython

@cython.final
@cython.auto_pickle(False)
cdef class WaySettings:
    cdef double turning, max_ahead, too_far, wall_distance, along_wall, leads_away, sideways
    cdef double reversed, give_up, lead, least_lead, most_lead, in_before, in_anyhow, in_beside
    cdef double aligned, aligned_share, beyond, persists, before, after, narrower, wider, in_wall
    cdef double threshold, first_seen_in, backs_out, follow, follow_beyond, queue_near, queue_far
    cdef double least_clear, most_clear, hidden, least_passed, most_passed, recently, lets_pass
    cdef double stuck, progress, line_up, nearly_lined_up, at_line_up, on_axis, on_axis_far
    cdef double off_axis, off_axis_near, off_axis_share, pursuit, beside, free, farther_beside
    cdef double aside_far, aside_step, faces, facing, keeps_side, has_side, back_aim, back_turn
    cdef double back_share, backs_to, gain, turn_cost, unknown_speed_share, wrong_by, weight
    cdef double at_post, same_width, posts_behind, posts_ahead, past_posts
    cdef double meeting, deep, lean, lean_from, abeam, abeam_width
