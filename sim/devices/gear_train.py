"""Mechanics between a servo's motion profile and the head: backlash, friction, encoder noise, swing."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class GearTrain:
    """Mechanics between profile and head.

    backlash_deg: total play between shaft and head; the head rests on the side that it was pushed to.
    """

    backlash_deg: float = 0.0
    settle_sigma_deg: float = 0.0
    encoder_sigma_ticks: float = 0.0
    ring_deg: float = 0.0
    ring_hz: float = 6.0
    ring_decay_s: float = 0.12

    def swing_deg(self, since_stop_s: float, stopped_from_deg_s: float) -> float:
        """Swing of the head at a time after a stop from a speed: a decaying oscillation."""
        if not self.ring_deg or not 0.0 <= since_stop_s < 12 * self.ring_decay_s:
            return 0.0
        amplitude = self.ring_deg * stopped_from_deg_s / 60.0
        decay = math.exp(-since_stop_s / self.ring_decay_s)
        return amplitude * decay * math.sin(2 * math.pi * self.ring_hz * since_stop_s)
