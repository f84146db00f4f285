"""Does a campaign pass? One case for every group of runs alike, and one for whatever was not analysed."""

from dataclasses import dataclass

from rtrun.analysis.deadline import Answer
from rtrun.report.document import verdict_line
from rtrun.report.study import Study


@dataclass(frozen=True, kw_only=True)
class Case:
    """One answer that the gate depends on."""

    about: str
    answer: str
    text: str
    passed: bool


@dataclass(frozen=True, kw_only=True)
class Gate:
    """All cases; `passed` when there is one and every one passed."""

    cases: tuple[Case, ...]

    @property
    def passed(self) -> bool:
        """Whether the gate lets the campaign through."""
        return bool(self.cases) and all(case.passed for case in self.cases)


def gate(study: Study, *, assume_independent: bool = False) -> Gate:
    """Judge a study. Only a proof passes: neither too little data nor an emulated board is one.

    What is proven if measurements are independent, from counts without order, passes only with `assume_independent`.
    A run that failed, is incomplete or was refused does not pass: what it hides is not known. An attempt that a restart
    of the target cut off is named, and passes when its run was measured again.
    """
    passing = {Answer.PROVEN, Answer.IF_INDEPENDENT} if assume_independent else {Answer.PROVEN}
    lines = [verdict_line(group) for group in study.groups]
    cases = [
        Case(about=line.about, answer=line.answer, text=line.text, passed=line.answer in passing) for line in lines
    ]
    cases += [
        Case(about=text.split(":", 1)[0], answer="NOT ANALYSED", text=text.split(":", 1)[-1].strip(), passed=False)
        for text in study.left_out
    ]
    cases += [
        Case(about=name, answer="REPEATED", text="cut off by a restart of the target, then measured again", passed=True)
        for name in study.source.repeated
    ]
    return Gate(cases=tuple(cases))
