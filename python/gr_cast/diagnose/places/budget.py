# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a search may take."""

import time
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Processor time of this thread that a search may take."""

    end_s: float

    @classmethod
    def of(cls, seconds: float) -> "Budget":
        return cls(end_s=time.thread_time() + seconds)

    @property
    def is_spent(self) -> bool:
        return time.thread_time() > self.end_s
