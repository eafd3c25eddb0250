"""Generated arguments for what scripts call, a small part of what `make fuzz` tries."""

import fuzz
from hypothesis import HealthCheck, Phase, given, settings

CASES = 400


@settings(
    max_examples=CASES,
    derandomize=True,
    deadline=None,
    database=None,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(fuzz.cases())
def test_every_argument_gives_a_right_result_or_a_message_that_helps(case):
    outcome, text = fuzz.outcome(case)
    assert outcome in ("right", "refused"), text
