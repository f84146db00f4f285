"""Two sides of one campaign compared: groups are matched whatever its variants, or its kernels, differ in."""

import json
import shutil

import pytest
from report.campaigns import at_minute, cyclic_run, latencies, oneshot_run

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.judgement.sides import names_of_sides, split
from rtrun.judgement.study import study


def write(root, variants, *, policies=("RR", "FIFO")):
    """Ten runs a variant and policy in turns; `variants` gives the mean lateness in us and parameters of each."""
    number = 0
    for repeat in range(5):
        for name, (mean_us, parameters) in variants.items():
            for policy in policies:
                number += 1
                run = f"{list(variants).index(name):03}-{policy}-{name}-r{repeat + 1}"
                lateness = latencies(2000, number, mean_us=mean_us)
                record = {"variant": name, "parameters": parameters, **at_minute(number)}
                cyclic_run(root, run, lateness, policy=policy, logs=True, **record)
    return root


def test_groups_of_two_variants_are_matched_though_a_setting_differs(tmp_path):
    new = {"priority": 80, "middleware": "zeromq"}
    root = write(tmp_path / "runs", {"old": (90, {"priority": 95}), "new": (90, new)})
    whole = study(root, bounds=False)
    assert names_of_sides(whole, "variant") == ["old", "new"]
    names, (first, second) = split(whole)
    assert names == ("old", "new")
    assert split(whole, "middleware")[0] == ("roscpp", "zeromq")
    for side in (first, second):
        assert sorted(group.parameters["policy"] for group in side.groups) == ["FIFO", "RR"]
        assert not {"variant", "priority"} & set().union(*(group.parameters for group in side.groups))


def test_what_one_middleware_alone_knows_tells_no_side_from_the_other(tmp_path):
    ros2 = {"middleware": "rcl", "rmw": "rmw_x_cpp", "domain_id": 7}
    whole = study(write(tmp_path / "runs", {"old": (90, {}), "new": (90, ros2)}), bounds=False)
    (default,) = [g for g in whole.groups if (g.parameters["policy"], g.parameters["middleware"]) == ("RR", "rcl")]
    default.parameters.pop("rmw")  # as the default of a run of the same campaign is left out
    for side in split(whole, "middleware")[1]:
        assert not ros2.keys() & set().union(*(group.parameters for group in side.groups))


def test_compare_answers_for_the_variants_of_one_folder(tmp_path, capsys):
    root = write(tmp_path / "runs", {"old": (90, {}), "new": (90, {})}, policies=("RR",))
    assert main(["compare", str(root)]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0] == "A: old, B: new"
    assert "DIFFERENT  " not in out and "cyclic_timer RR 100 Hz" in out and "only in" not in out


def write_kernels(root, repeats=5, board="board"):
    """A campaign on two kernels in turn, a boot for each block: latencies of the standard one are 90 us longer."""
    boot = 0
    for repeat in range(1, repeats + 1):
        for kernel in ("standard", "rt") if repeat % 2 else ("rt", "standard"):
            boot += 1
            is_rt = kernel == "rt"
            values = latencies(2000, boot + 100 * len(board), mean_us=90 if is_rt else 180)
            target = {"name": board, "kernel_release": "6.1", "preempt_rt": is_rt, "boot_id": f"boot-{boot}-{board}"}
            target["kernel_version"] = "#1 SMP PREEMPT_RT" if is_rt else "#1 SMP"
            name = f"00{1 + is_rt}-{kernel}-r{repeat}-{board}"
            oneshot_run(root, name, values, logs=True, kernel=kernel, target=target, **at_minute(boot))
    return root


def test_the_kernels_of_one_campaign_are_compared(tmp_path, capsys):
    root = write_kernels(tmp_path / "runs")
    assert main(["compare", str(root), "--by", "kernel", "--json"]) == 0
    (change, *_) = json.loads(capsys.readouterr().out)["changes"]
    comparison = change["comparison"]
    assert (comparison["answer"], comparison["units"], comparison["interleaved"]) == ("DIFFERENT", "boots", True)
    assert comparison["shifts"][0]["high_ns"] < -80_000, "from the standard kernel to PREEMPT_RT"
    assert main(["compare", str(root)]) == 0, "nothing else differs in this folder"
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "A: standard, B: rt" and "oneshot_timer RR 1000 us" in lines[1]
    assert "kernel=" not in lines[1]


def test_the_kernels_of_two_boards_are_compared_on_each(tmp_path, capsys):
    for board in ("panda", "pi"):
        write_kernels(tmp_path / "runs", board=board)
    assert main(["compare", str(tmp_path / "runs"), "--by", "kernel", "--json"]) == 0
    changes = json.loads(capsys.readouterr().out)["changes"]
    assert {(c["label"].rpartition(" on ")[2], c["comparison"]["answer"]) for c in changes} == {
        ("panda", "DIFFERENT"),
        ("pi", "DIFFERENT"),
    }


def test_one_round_of_the_kernels_shows_nothing_but_these_runs(tmp_path, capsys):
    root = write_kernels(tmp_path / "runs", repeats=1)
    assert main(["compare", str(root), "--by", "kernel"]) == 0
    assert "THESE RUNS DIFFER" in capsys.readouterr().out


def test_what_has_no_two_kernels_is_refused(tmp_path, capsys):
    root = write(tmp_path / "runs", {"old": (90, {}), "new": (90, {})}, policies=("RR",))
    assert main(["compare", str(root), "--by", "kernel"]) == 2
    assert "holds no kernels of a campaign" in capsys.readouterr().err
    both = write_kernels(tmp_path / "both", repeats=1)
    shutil.rmtree(both / "002-rt-r1-board")
    assert main(["compare", str(both), "--by", "kernel"]) == 2
    assert "holds the kernels standard: give a second folder" in capsys.readouterr().err
    assert main(["compare", str(root), str(root), "--by", "kernel"]) == 2


def test_what_is_no_pair_of_variants_is_refused(tmp_path, capsys):
    root = write(tmp_path / "runs", {"a": (90, {}), "b": (90, {}), "c": (90, {})}, policies=("RR",))
    assert main(["compare", str(root)]) == 2
    assert "holds the variants a, b, c: give a second folder" in capsys.readouterr().err
    assert main(["compare", str(root), "--sides", "a", "c"]) == 0
    assert main(["compare", str(root), "--sides", "a", "d"]) == 2
    assert main(["compare", str(root), str(root), "--sides", "a", "c"]) == 2
    with pytest.raises(UsageError, match="holds the variants"):
        split(study(root, bounds=False), names=["a", "a"])
