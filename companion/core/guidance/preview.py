"""A path as it will be driven, before it is: the rounded course, its length, and how long it takes.

On each segment speed rises from v_1 by a, keeps to v, and falls to v_2 by d, with a peak below v where there is no
room for it; at a sharp corner the boat turns on the spot, by the angle over the rate of turn:

    v_p^2 = min(v^2, (2 L a d + d v_1^2 + a v_2^2) / (a + d))      peak of a segment of length L
    T     = (v_p - v_1) / a + (v_p - v_2) / d + L_rest / v_p

Of a boat that rests where the path begins, heading along it, in still water. Lengths in m, site axes; times in s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from companion.core.geometry.frames import ssa
from companion.core.guidance.course import Course, PathLimits, Segment, plan_course
from companion.core.guidance.path import Path

ARC_STEP_RAD = 0.2
"""Of an arc, from one point to the next that is drawn: 5 mm off an arc of 1 m."""


class CoursePreview(NamedTuple):
    """`points`: (north, east) [m] along the course, lines by their ends."""

    points: tuple[tuple[float, float], ...]
    length_m: float
    duration_s: float


def preview(path: Path, limits: PathLimits) -> CoursePreview:
    """The course of a path; of one waypoint: a point, of no length."""
    if not path.lengths_m:
        return CoursePreview(path.points, 0.0, 0.0)
    course = plan_course(path, limits)
    return CoursePreview(tuple(_points(course)), course.length_m, _duration_s(course))


def _points(course: Course) -> Iterator[tuple[float, float]]:
    for segment in course.segments:
        steps = max(math.ceil(abs(segment.curvature_1_m) * segment.length_m / ARC_STEP_RAD), 1)
        for k in range(steps):
            yield segment.at(k * segment.length_m / steps)[:2]
    yield course.at(course.length_m)[:2]


def _duration_s(course: Course) -> float:
    total_s, limits = 0.0, course.limits
    speeds = (0.0, *course.speeds_m_s[1:])
    for i, segment in enumerate(course.segments):
        total_s += _segment_s(segment, speeds[i], speeds[i + 1], limits)
        if i:
            before = course.segments[i - 1]
            turn = abs(ssa(segment.angle_rad - before.at(before.length_m)[2]))
            total_s += turn / limits.yaw_rate_rad_s
    return total_s


def _segment_s(segment: Segment, first_m_s: float, last_m_s: float, limits: PathLimits) -> float:
    """T above; speeds are never below the crawl, as of `Course.speed_at`."""
    a, d, length = limits.acceleration_m_s2, limits.deceleration_m_s2, segment.length_m
    crawl = min(limits.crawl_m_s, segment.speed_m_s)
    first, last = max(first_m_s, crawl), max(last_m_s, crawl)
    peak = math.sqrt(min(segment.speed_m_s**2, (2 * length * a * d + d * first**2 + a * last**2) / (a + d)))
    peak = max(peak, first, last)
    changing_m = (peak**2 - first**2) / (2 * a) + (peak**2 - last**2) / (2 * d)
    return (peak - first) / a + (peak - last) / d + max(length - changing_m, 0.0) / peak
