"""Multi-hypothesis tracking of a vehicle over a sequence of bundles.

All places that the bundles so far allow are kept as a Gaussian mixture. Odometry predicts them, and the places found by the
next bundle's search update them, until one remains. This is the proposal of Talluri and Aggarwal (1992, section VIII): an
ambiguous place is resolved by a known translation and another measurement. Once the place is known, only its surroundings are
searched (the *bootstrap* mode, section IV-B).

``gaussian_place`` has the operations on single Gaussians, ``odometry`` the movement between two bundles, ``mixture`` prediction
and update of the hypotheses, ``tracker`` the state and its step, ``follow``, and ``document`` the result as text and JSON.
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
