"""The names that a package of terms and bodies imports (docs/environments/your_own.md).

This module needs what the service's processes have installed (`gaitway[up]`), and loads neither JAX nor
MuJoCo, since the API imports such packages, too.
"""

# ruff: noqa: E402
from typing import TYPE_CHECKING, Any

from gaitway.service.installed import use_code

use_code()

from core.environments.info import Slice, named
from core.environments.options import Range, Weight
from core.environments.plugins import Body
from core.environments.terms.actions import ActionTerm
from core.environments.terms.commands import (
    CommandRange,
    CommandTerm,
    EventTerm,
    PositionCommand,
    VelocityCommand,
)
from core.environments.terms.inventory import Inventory, ModelParts
from core.environments.terms.metrics import MetricTerm
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.readings import ContactCount, ContactForce, Reading
from core.environments.terms.term import (
    Array,
    CostTerm,
    Direction,
    Interval,
    Name,
    Names,
    OfAxis,
    OfBodies,
    OfBody,
    OfBodyContact,
    OfContact,
    OfHeight,
    RewardTerm,
    Term,
    Vector,
)
from core.environments.terms.terminations import TerminationTerm
from core.patterns import PATTERNS, Pattern, Patterns

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step
else:
    ModelIndex = Step = Any  # They need MuJoCo.

__all__ = [
    "PATTERNS",
    "ActionTerm",
    "Array",
    "Body",
    "CommandRange",
    "CommandTerm",
    "ContactCount",
    "ContactForce",
    "CostTerm",
    "Direction",
    "EventTerm",
    "Interval",
    "Inventory",
    "MetricTerm",
    "ModelIndex",
    "ModelParts",
    "Name",
    "Names",
    "ObservationTerm",
    "OfAxis",
    "OfBodies",
    "OfBody",
    "OfBodyContact",
    "OfContact",
    "OfHeight",
    "Pattern",
    "Patterns",
    "PositionCommand",
    "Range",
    "Reading",
    "RewardTerm",
    "Slice",
    "Step",
    "Term",
    "TerminationTerm",
    "Vector",
    "VelocityCommand",
    "Weight",
    "named",
]
