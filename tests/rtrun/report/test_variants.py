"""A and B of one campaign compared: groups are matched whatever the variants differ in."""

import pytest
from report.campaigns import cyclic_rows, latencies, write_run

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.report.study import study
from rtrun.report.variants import split_variants, variant_names


def write(root, variants, *, policies=("RR", "FIFO")):
    """Ten runs a variant and policy in turns; `variants` gives the mean lateness in us and parameters of each."""
    number = 0
    for repeat in range(5):
        for name, (mean_us, parameters) in variants.items():
            for policy in policies:
                number += 1
                run = f"{list(variants).index(name):03}-{policy}-{name}-r{repeat + 1}"
                rows = cyclic_rows(latencies(2000, number, mean_us=mean_us), 100)
                write_run(
                    root,
                    run,
                    "cyclic_timer_tests",
                    [rows],
                    {"frequency_hz": 100, "policy": policy, **parameters},
                    asked=2000,
                    variant=name,
                    start_time=f"2026-01-01T00:{number:02}:00+00:00",
                    end_time=f"2026-01-01T00:{number:02}:30+00:00",
                )
    return root


def test_groups_of_two_variants_are_matched_though_a_setting_differs(tmp_path):
    root = write(tmp_path / "runs", {"old": (90, {"priority": 95}), "new": (90, {"priority": 80})})
    whole = study(root, bounds=False)
    assert variant_names(whole) == ["old", "new"]
    names, (first, second) = split_variants(whole)
    assert names == ("old", "new")
    for side in (first, second):
        assert sorted(group.parameters["policy"] for group in side.groups) == ["FIFO", "RR"]
        assert not {"variant", "priority"} & set().union(*(group.parameters for group in side.groups))


def test_compare_answers_for_the_variants_of_one_folder(tmp_path, capsys):
    root = write(tmp_path / "runs", {"old": (90, {}), "new": (90, {})}, policies=("RR",))
    assert main(["compare", str(root)]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0] == "A: old, B: new"
    assert "DIFFERENT  " not in out and "cyclic_timer RR 100 Hz" in out and "only in" not in out


def test_what_is_no_pair_of_variants_is_refused(tmp_path, capsys):
    root = write(tmp_path / "runs", {"a": (90, {}), "b": (90, {}), "c": (90, {})}, policies=("RR",))
    assert main(["compare", str(root)]) == 2
    assert "holds the variants a, b, c: give a second folder" in capsys.readouterr().err
    assert main(["compare", str(root), "--variants", "a", "c"]) == 0
    assert main(["compare", str(root), "--variants", "a", "d"]) == 2
    assert main(["compare", str(root), str(root), "--variants", "a", "c"]) == 2
    with pytest.raises(UsageError, match="holds the variants"):
        split_variants(study(root, bounds=False), ["a", "a"])
