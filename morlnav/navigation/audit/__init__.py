"""Does a learned reward prefer the demonstration? Behaviours and a planner tell."""

from morlnav.navigation.audit.behaviours import Behaviour, PathFollower, alternative_behaviours, paths_around
from morlnav.navigation.audit.judge import RewardAudit
from morlnav.navigation.audit.report import write_audit
from morlnav.navigation.audit.verdict import Audit, Thresholds, audit_reward

__all__ = [
    "Audit",
    "Behaviour",
    "PathFollower",
    "RewardAudit",
    "Thresholds",
    "alternative_behaviours",
    "audit_reward",
    "paths_around",
    "write_audit",
]
