"""Basis of the residual: groups of smooth functions by what they depend on, which stand for no effect in particular.

    heading          a constant to the north and east, of force and of moving water; a constant error of heading;
                     sin, cos of k psi, k <= 3: force, heading; k <= 5: damping; k <= 2: specific force, place
    position         cos(i pi n) cos(j pi e) over the range of places, i + j <= 4: force, force with a moment of its
                     own; 0 < i + j <= 4: heading; < 4: moving water, damping, place; scale of places
    speed            products of u, v, r and their moduli: force, inertial sensors; shares of damping, of inertia;
                     accelerations: force; along and across the velocity: place
    thruster         its force times powers of itself, with play, its rate, its past, times the force of another; of
                     one, of all; the force of one in place of another's
    load, voltage    all forces times the total load now, or over 20 s and 60 s; times voltage
    time             cos(k pi t), k <= 6, of all logs, moving water with a constant; and sin, cos at the periods of the
                     latent force

A constant in NED has the word "heading" because its components in body axes vary with the heading.
"""

from __future__ import annotations

from collections.abc import Iterator

from sim.fitting.diagnose.posterior.linear import LinearisationPoint
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.residual_basis.basis import Basis
from sim.fitting.diagnose.residual_basis.group import FunctionGroup, append_groups
from sim.fitting.diagnose.residual_basis.motion import by_speed
from sim.fitting.diagnose.residual_basis.surroundings import by_heading, by_position
from sim.fitting.diagnose.residual_basis.thrust import by_load, by_thruster, by_voltage
from sim.fitting.diagnose.residual_basis.time import by_period, by_time

__all__ = ["FunctionGroup", "append_groups", "groups_at"]


def groups_at(physics: EffectPhysics, point: LinearisationPoint) -> tuple[FunctionGroup, ...]:
    """All groups at a fitted `point`; groups of variables that were not logged are left out."""
    basis = Basis(physics, point)

    def each() -> Iterator[FunctionGroup]:
        for maker in (by_position, by_heading, by_speed, by_thruster, by_load, by_voltage, by_time, by_period):
            yield from maker(basis)

    return tuple(each())
