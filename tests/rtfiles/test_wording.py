"""An error in a file is reported in our words, with its line and what may have been meant."""

import math
import re

import pytest

from rtfiles.config import key_names, parse
from rtfiles.errors import UsageError
from rtgen.board.machine import Machine
from rtgen.kconfig.data import Concern
from rtgen.profile import Profile
from rtrun.plan.campaign import Campaign, read_campaign
from rtrun.results.record import RunRecord
from rtrun.targets.config import LabgridConfig, LocalConfig, QemuConfig, SshConfig

WRONG = (
    None,
    [],
    {},
    "",
    "x" * 300,
    "n o\tt\n",
    -(10**30),
    10**30,
    1.5,
    math.nan,
    True,
    [1, {}, None],
    {"x": {"y": []}},
)
PYDANTIC = re.compile(r"should|[Ii]nput|[Ff]ield required|Unable|Extra")


@pytest.mark.parametrize(
    "model", [Campaign, Concern, LabgridConfig, LocalConfig, Machine, Profile, QemuConfig, RunRecord, SshConfig]
)
def test_no_sentence_is_of_the_library_below(model):
    with pytest.raises(UsageError) as caught:
        parse({}, model, "a.yml")
    messages = [str(caught.value)]
    for key in key_names(model):
        for value in WRONG:
            try:
                parse({key: value}, model, "a.yml")
            except UsageError as error:
                messages += [line for line in str(error).splitlines() if line.startswith(f"a.yml: {key}")]
    assert len(messages) > len(key_names(model))
    assert not [message for message in messages if PYDANTIC.search(message.partition(", got ")[0])]


CAMPAIGN = """
schema: 1
name: demo
common:
  <<: &common {policy: RR}
  repetitions: 10
runs:
- suite: cyclic_timer_tests
  frequncy_hz: 1000
- {suite: oneshot_timer_test}
-
  suite: oneshot_timer_tests
  <<: *common
  timeout_us: [1000,
    -1]
  condition: memroy
"""


def test_each_mistake_has_the_line_of_its_entry_and_what_may_have_been_meant(tmp_path):
    file = tmp_path / "campaign.yml"
    file.write_text(CAMPAIGN)
    with pytest.raises(UsageError) as caught:
        read_campaign(file)
    lines = [line.removeprefix(str(file)).partition(" known: ")[0] for line in str(caught.value).splitlines()]
    assert lines[0].startswith(":9: runs.0: unknown key 'frequncy_hz', did you mean 'frequency_hz'? cyclic_timer_tests")
    assert lines[1:] == [
        ":10: runs.1.suite: unknown suite 'oneshot_timer_test', did you mean 'oneshot_timer_tests'?",
        ":14: runs.2.timeout_us: timeout_us takes a whole number from 0 to 60000000, got -1",
        ":16: runs.2.condition: unknown condition 'memroy', did you mean 'memory'?",
    ]
