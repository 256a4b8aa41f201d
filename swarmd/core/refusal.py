"""Why robots refuse requests."""

from __future__ import annotations

from enum import StrEnum


class Refusal(StrEnum):
    """Why a robot refuses a request, or fails to carry it out."""

    INVALID_REQUEST = "invalid_request"  # a field is missing, of a wrong type or out of bounds
    STALE_EPOCH = "stale_epoch"  # the robot has changed since the epoch that the operator saw
    ESTOPPED = "estopped"
    FAULTED = "faulted"
    BUSY = "busy"  # an earlier request is still under way
    OVERTAKEN = "overtaken"  # a stop, a fault, a greater goal or another change came first
    TOO_LATE = "too_late"  # the start is too old or of unknown age, or its start time is over
    NO_GOAL = "no_goal"  # the robot has no goal to resume
    INVALID_GOAL = "invalid_goal"  # for other robots, of another run, or not signed by its issuer
    NOT_RUNNING = "not_running"
    DUPLICATE_ID = "duplicate_id"
    UNKNOWN_PATTERN = "unknown_pattern"
    INVALID_PARAMETER = "invalid_parameter"
    INVALID_CONDITION = "invalid_condition"
    MISSING_SENSOR = "missing_sensor"
    PATTERN_FAILED = "pattern_failed"  # the pattern's code raised, ended or took too long
    MEMBER_ALIVE = "member_alive"
    NOT_STOPPED = "not_stopped"  # zero did not reach the base, or the base moves on
    REVOKED = "revoked"  # the robot is no longer on the roster
    NOT_WRITTEN = "not_written"  # the disk is full or read-only
    INVALID_ROSTER = "invalid_roster"  # of another swarm, older, or not signed by its authority
    OTHER_VERSION = "other_version"  # the request is of another wire version
    NOT_SIGNED = "not_signed"  # the code is not signed by an operator of the roster
    NAME_TAKEN = "name_taken"  # the robot has a pattern of that name that was not pushed
    CHANGED_CODE = "changed_code"  # the file of a pushed pattern differs from the pushed code
    NOT_PERMITTED = "not_permitted"  # the role of the operator does not permit the request
