"""Causes come first, and what follows from them is said to."""

from gnomon.assess.verdict import merge_by_cause
from gnomon.findings import Finding


def finding(code, severity="warning"):
    return Finding(severity=severity, code=code, message=f"{code}.", consequence="So.", cure="Do.")


def told(*findings):
    return [(one.code, one.severity) for one in merge_by_cause(list(findings))]


def test_findings_of_one_severity_keep_their_order():
    assert told(finding("rate", "good"), finding("b"), finding("a")) == [
        ("b", "warning"),
        ("a", "warning"),
        ("rate", "good"),
    ]


def test_what_follows_from_a_cause_is_information_that_names_it():
    ordered = merge_by_cause([finding("target-scale", "problem"), finding("tag-spacing")])
    assert [(one.code, one.severity) for one in ordered] == [("tag-spacing", "problem"), ("target-scale", "info")]
    assert "tag-spacing" in ordered[1].consequence
    assert not ordered[1].cure


def test_a_cause_that_is_only_information_explains_nothing():
    assert told(finding("target-scale"), finding("tag-spacing", "info")) == [
        ("target-scale", "warning"),
        ("tag-spacing", "info"),
    ]


def test_what_is_good_to_know_follows_from_a_loud_cause_alone():
    seen = finding("turn-unseen", "info")
    assert merge_by_cause([seen, finding("parameter-changed")])[1].follows_from == "parameter-changed"
    assert seen in merge_by_cause([seen, finding("parameter-changed", "info")])


def test_the_more_fundamental_cause_explains_the_other():
    assert told(finding("frames-late"), finding("frames-repeated"), finding("reprojection", "problem"))[0] == (
        "frames-repeated",
        "problem",
    )


def test_consequences_come_after_causes_of_the_same_severity():
    assert [code for code, _ in told(finding("not-converged", "problem"), finding("noise-gaps", "problem"))] == [
        "noise-gaps",
        "not-converged",
    ]


def test_the_verdict_is_no_better_for_it():
    before = [finding("clock-drift"), finding("clock-jump"), finding("not-converged", "problem")]
    assert min(one.severity for one in before) == "problem" == merge_by_cause(before)[0].severity


def test_what_follows_from_a_cause_names_its_code():
    by_code = {finding.code: finding for finding in merge_by_cause([finding("reprojection"), finding("tag-spacing")])}
    assert by_code["reprojection"].follows_from == "tag-spacing"
    assert not by_code["tag-spacing"].follows_from
