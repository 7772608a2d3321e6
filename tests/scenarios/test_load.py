"""From TOML to a scenario and back: strict, and every refusal is one line that helps."""

from __future__ import annotations

import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import pytest

from plant import CellConfig
from plant.sensors import SENSORS
from qpmpc.config import ControllerConfig, ObserverConfig
from scenarios import (
    Scenario,
    ScenarioError,
    ScenarioKeyError,
    SetpointConfig,
    UnknownScenarioError,
    check_scenario,
    dump_scenario,
    load_scenario,
    shipped,
)
from scenarios.motion import MotionConfig

NAMES = (
    "constrained", "ecg", "harsh", "ideal", "latency", "other-arm", "paper", "paper-1d",
    "paper-law",
)  # fmt: skip


def refusal(*arguments, kind=ScenarioError, **named) -> str:
    with pytest.raises(kind) as caught:
        load_scenario(*arguments, **named)
    text = str(caught.value)
    assert "\n" not in text
    return text


# --- what is shipped -----------------------------------------------------------------------------


def test_the_scenarios_of_the_issue_are_shipped():
    assert set(NAMES) <= set(shipped())


@pytest.mark.parametrize("name", sorted(shipped()))
def test_a_shipped_scenario_loads_and_its_dump_loads_back_equal(name, write):
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.description
    assert load_scenario(write(dump_scenario(scenario))) == scenario


def test_the_scenarios_are_what_they_say():
    paper, one, ideal, law, ecg = (
        load_scenario(n) for n in ("paper", "paper-1d", "ideal", "paper-law", "ecg")
    )
    assert (paper.duration, paper.axes, paper.controller.horizon) == (15.0, ("x", "y", "z"), 8)
    assert (paper.cell.period, paper.cell.substeps) == (1e-3, 8)
    assert paper.cell.sensor.model == "nano17"
    assert (one.axes, one.motion.axes) == (("z",), ("z",))
    flaws = ideal.cell.imperfections
    assert ideal.cell.sensor.model == "ideal"
    sizes = {"torque_limit": 1.0, "stribeck_speed": 0.05, "joint_damping": 0.05}
    for f in fields(flaws):  # off, or of no effect without what is off
        assert getattr(flaws, f.name) == sizes.get(f.name, 0), f.name
    assert law.controller.observer.disturbance == "none"
    assert law.backend == "analytic"
    assert law.cell == paper.cell
    assert Path(ecg.motion.beats).is_file()


def test_every_key_is_in_the_dump():
    table = tomllib.loads(dump_scenario(load_scenario("paper")))

    def compare(kind, given, path=""):
        for field in fields(kind):
            here = f"{path}{field.name}"
            value = getattr(kind, field.name)
            if value is None:
                assert field.name not in given, here
            elif is_dataclass(value):
                compare(value, given[field.name], f"{here}.")
            else:
                assert field.name in given, here

    compare(load_scenario("paper"), table)


def test_what_a_file_leaves_out_is_as_in_the_records(write):
    scenario = load_scenario(write(""))
    observer = replace(ObserverConfig(), force_noise=SENSORS["nano17"].deviation)
    assert scenario == Scenario(name="mine", controller=ControllerConfig(observer=observer))
    assert scenario.cell == CellConfig()
    assert scenario.motion == MotionConfig()
    assert scenario.setpoint == SetpointConfig()
    part = load_scenario(write("[cell.contact]\nstiffness = 800.0\n"))
    assert part.cell.contact.stiffness == 800.0
    assert part.cell.contact.damping == CellConfig().contact.damping
    assert part.cell.tool == CellConfig().tool


@pytest.mark.parametrize("model", sorted(SENSORS))
def test_the_observer_is_told_the_noise_of_its_sensor_unless_the_scenario_says(model, write):
    sensor = f"cell.sensor.model={model}"
    known = load_scenario("paper", settings=[sensor]).controller.observer.force_noise
    assert known == SENSORS[model].deviation
    file = write(f"[cell]\nsensor.model = '{model}'\n")
    assert load_scenario(file).controller.observer.force_noise == known
    given = load_scenario("paper", settings=[sensor, "controller.observer.force_noise=0.5"])
    assert given.controller.observer.force_noise == 0.5


def test_infinite_bounds_and_none_survive_the_dump(write):
    scenario = load_scenario(
        "paper",
        settings=[
            "controller.bounds.rate=[-inf, 3.0]",
            "controller.control_horizon=4",
            'axes=["z", "x"]',
            "setpoint.steps=[{time = 0.5, z = -8.0}, {time = 0.7, x = 0.25, y = 0.0}]",
        ],
    )
    assert scenario.controller.bounds.rate == (-float("inf"), 3.0)
    assert scenario.setpoint.steps[0].x is None
    assert load_scenario(write(dump_scenario(scenario))) == scenario


# --- refusals ------------------------------------------------------------------------------------

UNKNOWN = [
    ("durations = 3.0", "durations", "duration"),
    ("[setpont]\nx = 1.0", "setpont", "setpoint"),
    ("[setpoint]\nxx = 1.0", "setpoint.xx", "x"),
    ("[[setpoint.steps]]\ntime = 1.0\nzz = 1.0", "setpoint.steps.0.zz", "z"),
    ("[cell]\nperiods = 0.001", "cell.periods", "period"),
    ("[cell.contact]\nstifness = 300.0", "cell.contact.stifness", "stiffness"),
    ("[cell.imperfections]\nfrictoin = 1.0", "cell.imperfections.frictoin", "friction"),
    ("[cell.tool]\nvelocity_dampin = 1.0", "cell.tool.velocity_dampin", "velocity_damping"),
    ("[cell.sensor]\nmodels = 'ideal'", "cell.sensor.models", "model"),
    ("[controller]\nhorizn = 8", "controller.horizn", "horizon"),
    ("[controller.model]\ndelays = 1", "controller.model.delays", "delay"),
    ("[controller.observer]\nforce_nois = 1.0", "controller.observer.force_nois", "force_noise"),
    ("[controller.bounds]\ncommands = [0.0, 1.0]", "controller.bounds.commands", "command"),
    ("[controller.bounds.force]\nzz = [0.0, 1.0]", "controller.bounds.force.zz", "z"),
    ("[motion]\nheart_rat = 1.0", "motion.heart_rat", "heart_rate"),
]


@pytest.mark.parametrize(("text", "key", "near"), UNKNOWN, ids=[key for _, key, _ in UNKNOWN])
def test_an_unknown_key_is_told_with_the_nearest_one(text, key, near, write):
    with pytest.raises(ScenarioKeyError, match="unknown key") as caught:
        load_scenario(write(text))
    assert (caught.value.source, caught.value.key) == ("mine.toml", key)
    assert str(caught.value).startswith(f"mine.toml: {key}: ")
    assert f"did you mean '{near}'?" in str(caught.value)


WRONG = [
    # wrong type
    ("duration = '15'", "duration"),
    ("duration = true", "duration"),
    ("seed = 1.5", "seed"),
    ("seed = 1.0", "seed"),
    ("seed = true", "seed"),
    ("seed = '1'", "seed"),
    ("name = 3", "name"),
    ("name = ''", "name"),
    ("backend = 1", "backend"),
    ("duration = 2026-01-01", "duration"),
    ("axes = 'x'", "axes"),
    ("axes = [1]", "axes.0"),
    ("cell = 3", "cell"),
    ("cell = [1.0]", "cell"),
    ("cell.contact = 'soft'", "cell.contact"),
    ("setpoint = 1.0", "setpoint"),
    ("setpoint.steps = 1.0", "setpoint.steps"),
    ("setpoint.steps = [1.0]", "setpoint.steps.0"),
    ("[[cell]]\nperiod = 0.001", "cell"),
    ("controller.horizon = 8.0", "controller.horizon"),
    ("controller.horizon = false", "controller.horizon"),
    ("cell.substeps = 8.5", "cell.substeps"),
    ("cell.contact.stiffness = true", "cell.contact.stiffness"),
    ("cell.sensor.model = 'nano18'", "cell.sensor.model"),
    ("cell.sensor.model = ['nano17']", "cell.sensor.model"),
    ("cell.sensor.model = {name = 'nano17'}", "cell.sensor.model"),
    ("cell.sensor.model = 17", "cell.sensor.model"),
    ("cell.sensor = 'nano17'", "cell.sensor"),
    ("controller.observer = 'none'", "controller.observer"),
    ("controller.observer.disturbance = 'constent'", "controller.observer.disturbance"),
    ("controller.bounds.command = 20.0", "controller.bounds.command"),
    ("controller.bounds.command = [1.0]", "controller.bounds.command.1"),
    ("controller.bounds.command = [-1.0, 0.0, 1.0]", "controller.bounds.command"),
    ("controller.bounds.command = ['-1', 1.0]", "controller.bounds.command.0"),
    ("motion.file = 3", "motion.file"),
    ("motion.force_rms = [1.0, 2.0]", "motion.force_rms.2"),
    # out of range
    ("duration = 0.0", "duration"),
    ("duration = -1.0", "duration"),
    ("duration = 1e9", "duration"),
    ("seed = -1", "seed"),
    ("axes = []", "axes"),
    ("axes = ['w']", "axes.0"),
    ("controller.horizon = 0", "controller.horizon"),
    ("controller.horizon = 100000", "controller.horizon"),
    ("controller.control_horizon = 0", "controller.control_horizon"),
    ("controller.force_weight = 0.0", "controller.force_weight"),
    ("controller.increment_weight = -1.0", "controller.increment_weight"),
    ("controller.reference_time = -0.1", "controller.reference_time"),
    ("controller.model.delay = -1", "controller.model.delay"),
    ("controller.model.stiffness = 0.0", "controller.model.stiffness"),
    ("controller.observer.force_noise = 0.0", "controller.observer.force_noise"),
    ("cell.period = 0.0", "cell.period"),
    ("cell.substeps = 0", "cell.substeps"),
    ("cell.contact.stiffness = -300.0", "cell.contact.stiffness"),
    ("cell.contact.damping = -1.0", "cell.contact.damping"),
    ("cell.imperfections.inertia_error = -1.0", "cell.imperfections.inertia_error"),
    ("cell.imperfections.friction_compensation = 1.1", "cell.imperfections.friction_compensation"),
    ("cell.imperfections.delay = 21", "cell.imperfections.delay"),
    ("cell.imperfections.inertia_error = [0.2, 0.1]", "cell.imperfections.inertia_error"),
    ("cell.imperfections.inertia_error = []", "cell.imperfections.inertia_error"),
    (
        "cell.imperfections.inertia_error = [0, 0, -1.5, 0, 0, 0, 0]",
        "cell.imperfections.inertia_error.2",
    ),
    ("cell.imperfections.inertia_error = 'much'", "cell.imperfections.inertia_error"),
    (
        "cell.imperfections.inertia_error = [0, nan, 0, 0, 0, 0, 0]",
        "cell.imperfections.inertia_error.1",
    ),
    ("cell.imperfections.stribeck = -0.1", "cell.imperfections.stribeck"),
    ("cell.imperfections.stribeck_speed = 0.0", "cell.imperfections.stribeck_speed"),
    ("cell.imperfections.torque_limit = 0.0", "cell.imperfections.torque_limit"),
    ("cell.imperfections.torque_limit = 1.5", "cell.imperfections.torque_limit"),
    ("cell.imperfections.joint_frequency = -20.0", "cell.imperfections.joint_frequency"),
    ("cell.imperfections.joint_damping = 2.0", "cell.imperfections.joint_damping"),
    ("cell.imperfections.encoder_resolution = -1e-6", "cell.imperfections.encoder_resolution"),
    ("cell.imperfections.encoder_resolution = 1.0", "cell.imperfections.encoder_resolution"),
    ("cell.imperfections.velocity_filter = 0.1", "cell.imperfections.velocity_filter"),
    ("cell.imperfections.delay_jitter = 1.0", "cell.imperfections.delay_jitter"),
    ("cell.imperfections.delay_jitter = true", "cell.imperfections.delay_jitter"),
    ("cell.imperfections.tip_mass = -0.01", "cell.imperfections.tip_mass"),
    ("cell.imperfections.tip_mass = 0.16", "cell.imperfections.tip_mass"),
    ("setpoint.steps = [{time = 0.0, x = 1.0}]", "setpoint.steps.0.time"),
    ("setpoint.steps = [{x = 1.0}]", "setpoint.steps.0.time"),
    ("motion.heart_rate = 10.0", "motion.heart_rate"),
    ("motion.rate_irregularity = 0.6", "motion.rate_irregularity"),
    ("motion.rate_steps = [{time = 1.0, rate = 9.0}]", "motion.rate_steps.0.rate"),
    (
        "motion.rate_steps = [{time = 2.0, rate = 1.0}, {time = 1.0, rate = 2.0}]",
        "motion.rate_steps",
    ),
    ("cell.sensor.spike_rate = -1.0", "cell.sensor.spike_rate"),
    ("cell.sensor.dropout_time = 0.0", "cell.sensor.dropout_time"),
    ("setpoint.steps = [{time = 1.0, x = 1.0, ramp = -1.0}]", "setpoint.steps.0.ramp"),
    ('setpoint = {file = "a.csv", steps = [{time = 1.0, x = 1.0}]}', "setpoint.steps"),
    ('setpoint = {file = "a.csv", z = -9.0}', "setpoint.z"),
    ("setpoint.live = {port = 80}", "setpoint.live.port"),
    ("setpoint.live = {}", "setpoint.live.port"),
    ("setpoint.live = {port = 5005, prot = 1}", "setpoint.live.prot"),
    ("setpoint.live = {port = 5005, largest_rate = 0.0}", "setpoint.live.largest_rate"),
    ('setpoint = {live = {port = 5005}, file = "a.csv"}', "setpoint.file"),
    ("setpoint = {live = {port = 5005}, steps = [{time = 1.0, x = 1.0}]}", "setpoint.steps"),
    # no number, and infinity where there is no bound
    ("duration = nan", "duration"),
    ("duration = inf", "duration"),
    ("setpoint.x = nan", "setpoint.x"),
    ("setpoint.x = inf", "setpoint.x"),
    ("setpoint.steps = [{time = 1.0, x = nan}]", "setpoint.steps.0.x"),
    ("setpoint.steps = [{time = inf, x = 1.0}]", "setpoint.steps.0.time"),
    ("cell.contact.stiffness = nan", "cell.contact.stiffness"),
    ("cell.contact.stiffness = inf", "cell.contact.stiffness"),
    ("controller.bounds.command = [nan, 1.0]", "controller.bounds.command.0"),
    ("controller.observer.input_drift = inf", "controller.observer.input_drift"),
    ("motion.reference_stiffness = inf", "motion.reference_stiffness"),
    # values that do not fit one another
    ("controller.bounds.command = [1.0, -1.0]", "controller.bounds.command"),
    ("controller.bounds.command = [1.0, 2.0]", "controller.bounds.command"),
    ("controller.bounds.rate = [-2.0, -1.0]", "controller.bounds.rate"),
    ("controller.bounds.velocity = [0.4, -0.4]", "controller.bounds.velocity"),
    ("controller.control_horizon = 9", "controller.control_horizon"),
    ("controller.bounds.force.z = [-20.0, -11.0]", "setpoint.z"),
    ("setpoint.x = 9.0\ncontroller.bounds.force.x = [-8.0, 8.0]", "setpoint.x"),
    (
        "setpoint.steps = [{time = 1.0, z = 1.0}]\ncontroller.bounds.force.z = [-20.0, -0.5]",
        "setpoint.steps.0.z",
    ),
    ("setpoint.steps = [{time = 2.0, x = 1.0}, {time = 1.0, x = 2.0}]", "setpoint.steps"),
    ("axes = ['x', 'x']", "axes"),
]


@pytest.mark.parametrize(
    ("text", "key"), WRONG, ids=[text.replace("\n", "; ") for text, _ in WRONG]
)
def test_a_wrong_value_is_told_with_file_and_key(text, key, write):
    with pytest.raises(ScenarioKeyError) as caught:
        load_scenario(write(text))
    assert (caught.value.source, caught.value.key) == ("mine.toml", key)
    assert str(caught.value) == f"mine.toml: {key}: {caught.value.reason}"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("duration = ", "not TOML"),
        ("[cell\nperiod = 1", "not TOML"),
        ("duration = 1.0\nduration = 2.0", "not TOML"),
        (b"\x89PNG\r\n\x1a\n\x00\xff\xfe", "not a text file"),
        ("this is prose, no scenario", "not TOML"),
    ],
    ids=["no value", "open bracket", "key twice", "binary", "prose"],
)
def test_a_file_that_is_no_scenario_is_told(content, word, write):
    path = write(content)
    text = refusal(path)
    assert text.startswith(path)
    assert word in text


def test_a_missing_file_and_a_folder_are_told(tmp_path):
    missing, folder = tmp_path / "none.toml", tmp_path / "folder.toml"
    folder.mkdir()
    assert "No such file" in refusal(str(missing))
    assert "directory" in refusal(str(folder)).lower()


def test_an_unknown_scenario_is_told_with_the_nearest_one():
    text = refusal("papr", kind=UnknownScenarioError)
    assert "did you mean 'paper'?" in text
    assert all(name in text for name in NAMES)
    assert "did you mean" not in refusal("quartz", kind=UnknownScenarioError)


# --- settings ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "read", "value"),
    [
        ("duration=2.5", lambda s: s.duration, 2.5),
        ("duration=3", lambda s: s.duration, 3.0),
        ("seed = 7", lambda s: s.seed, 7),
        ("cell.sensor.model=mini45", lambda s: s.cell.sensor.model, "mini45"),
        ('cell.sensor.model="mini45"', lambda s: s.cell.sensor.model, "mini45"),
        (
            "controller.bounds.rate=[-1.0, inf]",
            lambda s: s.controller.bounds.rate,
            (-1.0, float("inf")),
        ),
        ("axes=['z']", lambda s: s.axes, ("z",)),
        ("description=a = b", lambda s: s.description, "a = b"),
    ],
)
def test_a_setting_changes_one_key(setting, read, value):
    assert read(load_scenario("paper", settings=[setting])) == value
    assert read(load_scenario("paper")) != value


def test_the_last_setting_wins_and_settings_win_over_options():
    scenario = load_scenario("paper", top={"seed": 1}, settings=["seed=2", "seed=3"])
    assert scenario.seed == 3


@pytest.mark.parametrize("text", ["seed", "=3", "a..b=3", ".seed=1", "seed.=1", ""])
def test_a_malformed_setting_is_told(text):
    assert "expected key.path=value" in refusal("paper", settings=[text])


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("cell.contact.stifness=3.0", "cell.contact.stifness"),
        ("cell.contact.stiffness=-3.0", "cell.contact.stiffness"),
        ("cell.contact.stiffness=soft", "cell.contact.stiffness"),
        ("cell.contact=3", "cell.contact"),
        ("controller.horizon=0", "controller.horizon"),
        ("seed.first=1", "seed"),
        ("setpoint.x=9.0", "setpoint.x"),
        ("controller.bounds.command=[2.0, 1.0]", "controller.bounds.command"),
    ],
)
def test_a_wrong_setting_is_told_as_one(setting, key):
    with pytest.raises(ScenarioKeyError) as caught:
        load_scenario("paper", settings=[setting])
    assert caught.value.source == "--set"
    assert caught.value.key.startswith(key)


def test_an_error_of_the_file_is_not_blamed_on_a_setting(write):
    with pytest.raises(ScenarioKeyError) as caught:
        load_scenario(write("[cell.contact]\nstiffness = -1.0"), settings=["seed=1"])
    assert caught.value.source == "mine.toml"


def test_options_are_checked_like_the_file():
    for top, key in (({"duration": -1.0}, "duration"), ({"seed": -1}, "seed")):
        with pytest.raises(ScenarioKeyError) as caught:
            load_scenario("paper", top=top)
        assert caught.value.key == key


def test_check_scenario_needs_a_name():
    with pytest.raises(ScenarioKeyError, match="name: is missing"):
        check_scenario({}, "a table")


# --- files of the motion -------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["file", "beats"])
def test_motion_files_count_from_the_scenarios_folder(key, tmp_path, monkeypatch):
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "a.toml").write_text(f"[motion]\n{key} = 'data/m.csv'\n")
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("study/a.toml")
    assert getattr(scenario.motion, key) == str((folder / "data" / "m.csv").resolve())
    (folder / "b.toml").write_text(f"[motion]\n{key} = '{tmp_path}/m.csv'\n")
    assert getattr(load_scenario("study/b.toml").motion, key) == f"{tmp_path}/m.csv"


def test_motion_files_of_the_command_line_count_from_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("paper", motion=Path("m.csv"))
    assert scenario.motion.file == str(tmp_path / "m.csv")


def test_a_recording_replaces_the_motion_but_for_its_axes(write):
    path = write("[motion]\naxes = ['z']\nheart_rate = 1.5\nbeats = 'b.csv'\n")
    motion = load_scenario(path, motion=Path("/m.csv")).motion
    assert motion == MotionConfig(file="/m.csv", axes=("z",))


def test_beats_replace_the_beats_and_keep_the_rest(write):
    path = write("[motion]\naxes = ['z']\nrespiration_rate = 0.3\nfile = 'm.csv'\n")
    motion = load_scenario(path, beats=Path("/b.csv")).motion
    assert motion == MotionConfig(beats="/b.csv", axes=("z",), respiration_rate=0.3)


def test_a_recording_and_beats_exclude_each_other():
    text = refusal("paper", motion=Path("m.csv"), beats=Path("b.csv"))
    assert "--motion" in text
    assert "--beats" in text


@pytest.mark.parametrize("name", ["motion", "beats"])
def test_a_motion_that_is_no_table_is_told_beside_an_override(name, write):
    path = write("motion = 3")
    assert "motion: must be a table" in refusal(path, **{name: Path("m.csv")})
