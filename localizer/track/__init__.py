"""Follows a vehicle from one bundle to the next.

Every place that the looks so far allow is kept, moved along with the odometry and compared with what the next look allows,
until one remains (Talluri and Aggarwal 1992, conclusions: an ambiguous place is resolved by a known translation and another
look; a vehicle that knows where it was need search only near there).

``places`` has the algebra of uncertain places, ``odometry`` the movement between two bundles, ``mixture`` the hypotheses,
``tracker`` the state and its one step, ``follow``; ``report`` and ``plot`` show what came of it.
"""

from localizer.track.odometry import Movement, Odometry, load_odometry
from localizer.track.tracker import Mode, Step, Tracker, follow, follow_bundle

__all__ = [
    "Mode",
    "Movement",
    "Odometry",
    "Step",
    "Tracker",
    "follow",
    "follow_bundle",
    "load_odometry",
]
