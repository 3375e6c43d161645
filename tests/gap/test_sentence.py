"""The sentence says what is missing, how sure that is, and what to do."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from realsim.gap.answer.check import Check
from realsim.gap.answer.sentence import advice, amount, number, phrase, removed, sentence
from realsim.gap.answer.verdict import Judgement
from realsim.gap.effects import EFFECTS
from realsim.gap.verdicts import GapVerdict


def cause(
    effect: str, value: float, unit: str, low: float, high: float, name: str = "amount", **place: Any
) -> dict[str, Any]:
    return {"effect": effect, "parameters": {name: {"value": value, "unit": unit, "ci90": [low, high]}}, **place}


def shrunk(fraction: float = 0.83, low: float = 0.74, high: float = 0.88, kind: str = "validation") -> Check:
    """A check on which the knee was off by 51 mrad of a motion of 0.41 rad, and is by 14 mrad with the causes."""
    knee = {"unit": "rad", "motion": 0.41, "rms_before": 0.051, "rms_after": 0.014, "floor": 0.002}
    quiet = {"unit": "rad/s", "motion": 2.0, "rms_before": 0.02, "rms_after": 0.01, "floor": 0.03}
    signals = {"joint_pos": knee, "joint_vel": quiet}
    return Check(("run_05",), kind, 100.0, 100.0 * (1 - fraction), 9.0, (low, high), signals)


KNEE = cause("coulomb_friction", 1.9, "N m", 1.6, 2.2, joints=["left_knee_joint"])
LATE = cause("command_delay", 0.012, "s", 0.011, 0.0133)
SEEN_LATE = cause("observation_delay", 0.012, "s", 0.01, 0.014)
WHERE = [{"signal": "joint_pos", "joint": "left_knee_joint", "phase": "reversal", "share": 0.6}]

LOOKS = [{"joint": "left_knee_joint", "what": "friction-like", "explains": 0.7}]


def say(
    verdict: str,
    causes: Any,
    equivalent: Any = (),
    of: Any = None,
    has: tuple[str, ...] = ("joint_torque",),
    ends: tuple[str, ...] = (),
    lead: Any = None,
) -> str:
    case: Any = SimpleNamespace(has=lambda s: s in has, floating=False, has_imu=False, runs=[], command_kind="position")
    judgement = Judgement(GapVerdict(verdict), ("came",), ends, stays=verdict == "partly_explained")
    return sentence(judgement, causes, equivalent, of or shrunk(), WHERE, LOOKS, case, lead)


def test_identified_is_the_sentence_of_the_promise() -> None:
    assert say("identified", [KNEE]) == (
        "Your model lacks Coulomb friction of 1.9 N m at left knee; with it, 83 % of the squared error is gone (on a "
        "run that was kept back)."
    )


def test_what_holds_beside_everyday_deviations_only_is_said_so() -> None:
    check = replace(shrunk(-0.04, -0.05, -0.02), beside=0.8, beside90=(0.41, 0.47))
    assert say("identified", [KNEE], of=check).endswith(
        "41 % to 47 % of what everyday deviations leave is gone (on a run that was kept back), and −4 % of all."
    )


def test_what_unseen_runs_do_not_confirm_is_not_said_to_be_removed() -> None:
    assert say("identified", [KNEE], of=shrunk(-0.11, -0.66, 0.47)).endswith(
        "the squared error does not surely shrink (on a run that was kept back) (by −11 % [−66, 47])."
    )


@pytest.mark.parametrize(
    ("effect", "value", "unit", "ends", "said"),
    [
        ("stiffness_gain", 0.75, "ratio", (0.7, 0.8), "stiffness gain (kp) is 0.75 times [0.7, 0.8] the model's"),
        (
            "coulomb_friction",
            -0.2,
            "N m",
            (-0.3, -0.1),
            "Coulomb friction is 0.2 N m [0.1, 0.3] too large in the model",
        ),
        ("joint_offset", -0.04, "rad", (-0.05, -0.03), "encoder zero offset −0.04 rad [−0.05, −0.03] is missing"),
        ("torque_limit", 13.0, "N m", (12, 14), "a torque limit of 13 N m [12, 14] is missing"),
        (
            "load_friction",
            0.15,
            "ratio",
            (0.1, 0.2),
            "load-dependent friction 15 % of the drive's torque [10, 20] is missing",
        ),
        ("external_force", -12.0, "N", (-14, -10), "external force −12 N [−14, −10] is missing"),
    ],
)
def test_phrases(effect: str, value: float, unit: str, ends: tuple[float, float], said: str) -> None:
    assert phrase(cause(effect, value, unit, *ends, joints=["hip"])) == f"hip: {said}"


@pytest.mark.parametrize(
    ("effect", "name", "unit", "place", "said", "long"),
    [
        ("com_offset", "x", "m", {"bodies": ["forearm"]}, "needs its centre of mass changed by x −0.1 m on forearm",
         "forearm: centre of mass is to be changed by x −0.1 m [−0.12, −0.08] in the model"),
        ("link_geometry", "length", "m", {"bodies": ["fore"]}, "needs its link geometry changed by −0.1 m on fore",
         "fore: link geometry is to be changed by −0.1 m [−0.12, −0.08] in the model"),
        ("joint_offset", "offset", "m", {"joints": ["lift"]}, "needs its encoder zero offset changed by −0.1 m at lift",
         "lift: encoder zero offset is to be changed by −0.1 m [−0.12, −0.08] in the model"),
        ("joint_offset", "offset", "rad", {"joints": ["hip"]}, "lacks encoder zero offset of −0.1 rad at hip",
         "hip: encoder zero offset −0.1 rad [−0.12, −0.08] is missing"),
    ],
)  # fmt: skip
def test_a_direction_is_that_of_the_patch(
    effect: str, name: str, unit: str, place: dict[str, Any], said: str, long: str
) -> None:
    found = cause(effect, -0.1, unit, -0.12, -0.08, name=name, **place)
    assert say("identified", [found]).startswith(f"Your model {said}; with it")
    assert phrase(found) == long


def test_payloads_are_added_or_taken_off() -> None:
    more = cause("payload", 1.2, "kg", 1.0, 1.4, name="mass", bodies=["torso_link"])
    more["parameters"] |= {
        axis: {"value": v, "unit": "m", "ci90": [v, v]} for axis, v in zip("xyz", (0, 0.1, -0.2), strict=True)
    }
    assert phrase(more) == "torso: a payload of 1.2 kg [1, 1.4] at (0, 0.1, −0.2) m is missing"
    less = cause("payload", -0.3, "kg", -0.4, -0.2, name="mass", bodies=["torso_link"])
    assert phrase(less) == "torso is 0.3 kg [0.2, 0.4] lighter than in the model"


def test_a_force_is_said_by_what_matters_of_it_and_by_when() -> None:
    push = cause("external_force", 0.2, "N", 0.1, 0.3, name="fx", bodies=["trunk"])
    push["parameters"] |= {"fz": {"value": 32.7, "unit": "N", "ci90": [28.9, 36.5]}}
    always = {"start": {"value": -10.0, "unit": "s"}, "end": {"value": 1e4, "unit": "s"}}
    passing = {"start": {"value": 1.1, "unit": "s"}, "end": {"value": 3.03, "unit": "s"}}
    for window, when in (({}, ""), (always, ""), (passing, " from 1.1 s to 3.03 s")):
        said = phrase(push | {"parameters": push["parameters"] | window})
        assert said == f"trunk: external force fz 32.7 N [28.9, 36.5]{when} is missing"


def test_ground_is_lower_or_higher() -> None:
    low = cause("terrain_height", -0.016, "m", -0.019, -0.013, bodies=["block_2"])
    assert phrase(low) == "block 2: terrain height is 0.016 m [0.013, 0.019] lower than in the model"
    high = cause("terrain_height", 0.016, "m", 0.013, 0.019, bodies=["block_2"])
    assert phrase(high) == "block 2: terrain height is 0.016 m [0.013, 0.019] higher than in the model"


def test_effects_that_act_everywhere_have_no_place() -> None:
    assert phrase(LATE) == "command delay 12 ms [11, 13.3] is missing"


@pytest.mark.parametrize("effect", sorted(EFFECTS))
def test_every_effect_can_be_said(effect: str) -> None:
    text = phrase(cause(effect, 0.5, "m", 0.4, 0.6, name="mass", bodies=["torso_link"]))
    assert EFFECTS[effect].title in text
    assert text.startswith("torso: ")


@pytest.mark.parametrize(
    ("fraction", "low", "high", "said"),
    [
        (0.83, 0.74, 0.88, "83 % [74, 88]"),
        (0.996, 0.992, 0.998, "99.6 % [99.2, 99.8]"),
        (0.99999, 0.9998, 1.0, ">99.9 % [>99.9, 100.0]"),
        (0.1, -0.05, 0.2, "10 % [−5, 20]"),
    ],
)
def test_shares_never_round_to_everything(fraction: float, low: float, high: float, said: str) -> None:
    assert removed(shrunk(fraction, low, high)) == said


def test_cannot_tell_says_what_to_record() -> None:
    said = say("ambiguous", [LATE], [[SEEN_LATE]])
    assert said.startswith("Cannot tell: command delay 12 ms [11, 13.3] is missing, or observation delay")
    assert said.endswith("to tell them apart, record an IMU or base pose.")


def test_rivals_without_a_signal_that_tells_are_told_by_motion() -> None:
    viscous = cause("viscous_friction", 0.4, "N m s/rad", 0.3, 0.5, joints=["left_knee_joint"])
    said = say("ambiguous", [KNEE], [[viscous]])
    assert EFFECTS["coulomb_friction"].words.excitation[0] in said


def test_no_signal_is_asked_for_that_the_log_has() -> None:
    damping = cause("damping_gain", 1.4, "ratio", 1.2, 1.6, joints=["left_knee_joint"])
    viscous = cause("viscous_friction", 0.4, "N m s/rad", 0.3, 0.5, joints=["left_knee_joint"])
    assert say("ambiguous", [damping], [[viscous]], has=()).endswith("record measured torque.")
    assert say("ambiguous", [damping], [[viscous]]).endswith("record fast motion; several speeds.")
    assert say("ambiguous", [LATE], [[SEEN_LATE]], has=("base_pos",)).endswith("record commands that change; motion.")


def test_what_only_some_rivals_are_told_by_is_no_clause_of_the_advice() -> None:
    damping = cause("damping_gain", 1.4, "ratio", 1.2, 1.6, joints=["left_knee_joint"])
    assert "tells it" not in say("ambiguous", [damping], [[KNEE]], has=())


def test_unknown_causes_say_how_far_off_the_simulator_is_and_what_it_looks_like() -> None:
    said = say("unexplained", [])
    assert said.startswith(
        "No cause that this library knows, most of it in left knee (reversal): joint position 51 mrad"
    )
    assert "rms of a motion of 0.41 rad rms; it looks friction-like (left knee); record one run twice" in said
    assert "joint velocity" not in said  # within its floor


def test_advice_asks_for_one_recording_and_for_no_sensor_that_such_robots_lack(monkeypatch: pytest.MonkeyPatch) -> None:
    for has in ((), ("joint_torque",)):
        assert "torque" not in say("unexplained", [], has=has)
        assert say("unexplained", [], has=has).count("record") == 1
    monkeypatch.setattr("realsim.gap.answer.sentence.replicates", lambda case: [[0, 1]])
    assert say("unexplained", []).endswith("record left knee alone, slowly and fast, over its whole range.")
    assert "motor's current where the drive reports it" in say("unexplained", [], has=())


def test_what_explains_a_part_and_holds_is_a_cause_with_its_rest() -> None:
    said = say("partly_explained", [KNEE])
    assert said.startswith("Your model lacks Coulomb friction of 1.9 N m at left knee; with it, 83 % of the squared")
    assert "A part stays: joint position 14 mrad rms of a motion of 0.41 rad rms (51 mrad before)" in said
    assert "it looks friction-like (left knee)" in said


def test_what_does_not_hold_is_the_nearest_and_no_cause() -> None:
    said = say("unexplained", [KNEE])
    assert said.startswith("Not explained, most of it in left knee (reversal). The nearest is left knee: Coulomb")
    assert "it may only imitate the cause. What stays: joint position 14 mrad rms" in said


def test_a_value_at_the_end_of_its_range_is_said() -> None:
    said = say("unexplained", [KNEE], ends=("friction",))
    assert "with friction as far as this library goes; with it" in said
    assert "it may only imitate the cause" in said


def test_a_sentence_has_one_share_and_it_is_the_check_s() -> None:
    """Figures once contradicted each other: 7 % removed, and 16 % stays."""
    for verdict in ("identified", "partly_explained", "unexplained"):
        said = say(verdict, [KNEE])
        assert re.findall(r"\d+ %", said) == ["83 %"]


def test_what_the_check_is_and_no_gap_are_said() -> None:
    assert "the run that it was fitted to" in say("identified", [KNEE], of=shrunk(kind="fitted"))
    assert "each left out in turn" in say("identified", [KNEE], of=shrunk(kind="left_out_in_turn"))
    assert say("no_gap", []).startswith("No gap that these runs can show")


def test_every_verdict_has_its_advice() -> None:
    case: Any = SimpleNamespace(has=lambda s: False, floating=False, has_imu=False, runs=[], command_kind="position")
    said = {v: advice(Judgement(v, ()), [LATE], [[SEEN_LATE]], WHERE, case) for v in GapVerdict}
    assert said[GapVerdict.AMBIGUOUS] == "to tell them apart, record an IMU or base pose"
    assert "model.xml" in said[GapVerdict.IDENTIFIED]
    assert said[GapVerdict.PARTLY_EXPLAINED] == said[GapVerdict.UNEXPLAINED]


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(0.0137, "rad", "14 mrad"), (0.41, "rad", "0.41 rad"), (0.0031, "m", "3.1 mm"), (12.4, "N m", "12 N m"),
     (0.0, "rad", "0 mrad"), (0.5, "m/s^2", "0.5 m/s²")],
)  # fmt: skip
def test_amounts_are_in_a_person_s_units(value: float, unit: str, text: str) -> None:
    assert amount(value, unit) == text


def test_two_causes_are_added_together() -> None:
    assert "at left knee and lacks command delay of 12 ms; with them, 83 %" in say("identified", [KNEE, LATE])
    gain = cause("motor_gain", 0.8, "ratio", 0.7, 0.9, joints=["hip"])
    assert "with them corrected, 83 %" in say("identified", [KNEE, gain])


def test_a_single_component_says_which_way() -> None:
    shift = cause("com_offset", 0.065, "m", 0.057, 0.073, name="z", bodies=["upper"])
    assert phrase(shift) == "upper: centre of mass is to be changed by z 0.065 m [0.057, 0.073] in the model"


def test_a_delay_is_no_vector() -> None:
    late = cause("command_delay", 0.0176, "s", 0.014, 0.0211, name="delay")
    assert phrase(late) == "command delay 17.6 ms [14, 21.1] is missing"


def test_what_all_alternatives_share_is_said_once() -> None:
    damping = cause("damping_gain", 0.67, "ratio", 0.6, 0.73, name="ratio", joints=["axis"])
    said = say("ambiguous", [LATE, damping], [[damping, SEEN_LATE]])
    assert said.startswith("axis: damping gain (kd) is 0.67 times")
    assert said.count("damping gain") == 1
    assert "Beside that, cannot tell: command delay 12 ms [11, 13.3] is missing, or observation delay" in said
    assert "Beside that" not in say("ambiguous", [LATE], [[LATE, damping]])


def test_no_minus_stands_before_a_zero() -> None:
    assert [number(v) for v in (-0.0, 0.0, -0.5)] == ["0", "0", "−0.5"]


def test_what_no_run_determines_is_not_a_number() -> None:
    arm = cause("payload", 0.12, "kg", 0.1, 0.14, name="mass", bodies=["arm"])
    arm["parameters"] |= {axis: {"value": 0.0, "unit": "m", "ci90": [-0.2, 0.2]} for axis in "xyz"}
    arm["parameters"]["y"]["note"] = "not determined"
    assert "at (0, not determined, 0) m" in phrase(arm)


@pytest.mark.parametrize(("verdict", "said"), [("no_gap", "robots of one kind differ by"), ("unexplained", "nearest")])
def test_where_nothing_passes_the_nearest_cause_is_a_lead(verdict: str, said: str) -> None:
    assert said in say(verdict, [], lead=KNEE)
    assert "1.9 N m" in say(verdict, [], lead=KNEE)
    assert said not in say(verdict, [])
