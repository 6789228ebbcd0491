"""The paper's claims asked anew of an arm: which guidance is led astray where no grid of poses can go.

What is asked was written down after a trial with 6 seeds and before any run with more; the paper makes none
of these claims.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Final

from guided_gym.train.claims import EARLY, MARGIN, Claim, gets_worse, lower, no_worse
from guided_gym.train.results import Key
from guided_gym.train.specs import GuidanceSpec

ARM: Final = "PlanarArm4"
WAVE: Final = "wave(robot=point)"
FOUR_LINKS: Final = "roadmap(robot=inner)"
THREE_LINKS: Final = "searched(guidance=rrt, robot=links(3))"
GUIDANCES: Final = (
    "rrt", "goal_distance", "lazy_prm", "medial_axis", "hybrid", "prm", "oracle",
    WAVE, FOUR_LINKS, THREE_LINKS,
)  # fmt: skip


def arm_claims() -> list[Claim]:
    """What the paper says of its problems in the plane, asked of an arm of four links."""
    return list(_claims())


def _key(guidance: str) -> Key:
    return ARM, GuidanceSpec(guidance).label


def _claims() -> Iterator[Claim]:
    yield Claim(
        f"rrt's SE per sample is higher after its first {EARLY} samples than over them",
        (_key("rrt"),),
        partial(gets_worse, (_key("rrt"),)),
        "RRT [is] doing well and then poorly as it struggles to get through narrow passages",
    )
    for guidance, why in (
        ("lazy_prm", "It ignores the walls between the windows, and four dimensions hold more ways through "
         "them than failures can refute."),
        ("medial_axis", "The tool's way along the skeleton says nothing of the links behind it."),
    ):  # fmt: skip
        astray = (_key("rrt"), _key(guidance))
        yield Claim(
            f"{guidance} is led astray: it has more total SE than rrt",
            astray,
            partial(lower, (astray,), "total_efficiency"),
            f"{'LazyPRM' if guidance == 'lazy_prm' else 'MedialAxisGuidance'} … lead the search astray",
            why,
        )
        yield Claim(
            f"over the first {EARLY} samples, rrt's SE is at most {MARGIN:g} nat above {guidance}'s",
            astray,
            partial(no_worse, (astray,)),
            "RRT is comparable to other algorithms initially",
        )
    parts = tuple((_key("hybrid"), _key(part)) for part in ("lazy_prm", "medial_axis"))
    yield Claim(
        "hybrid has less total SE than lazy_prm, and than medial_axis",
        tuple(dict.fromkeys(key for pair in parts for key in pair)),
        partial(lower, parts, "total_efficiency"),
        "a hybrid guiding space … has overall better guidance",
        "Neither of its parts sees a way here, and what neither sees no mixture does.",
    )
    for better, worse, what in (
        (
            WAVE,
            "medial_axis",
            "the tool's way through the workspace guides better as a wave than as a skeleton",
        ),
        (FOUR_LINKS, THREE_LINKS, "all links without their width guide better than three of four"),
        ("prm", FOUR_LINKS, "their width counts"),
    ):
        pair = (_key(better), _key(worse))
        yield Claim(
            f"{what}: {better} has less total SE than {worse}",
            pair,
            partial(lower, (pair,), "total_efficiency"),
        )
