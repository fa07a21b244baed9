"""What planning refuses: every message names the value, the bound and the next step."""


class PlanningError(Exception):
    """Base of the errors that planning raises on purpose."""


class ImpossiblePlan(PlanningError):
    """The stroke, the limits or the machine cannot be planned as asked; nothing was skipped or shortened."""


class OutsideMachine(PlanningError):
    """Some point of the drawing lies outside the machine's travel."""
