"""Names of methods, and reward models that join from elsewhere."""

import textwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import ACTIONS, CONTEXT, OBS, PROXIES, built, demos_of, steps_of

from qdil import methods, plugins
from qdil.config import make_config
from qdil.errors import ConfigError
from qdil.imitation.reward_model import InputModel, Inputs
from qdil.methods import describe, method_names, parse_method, register

IMITATORS = ["gail", "vail", "airl", "giril", "pwil", "maxent", "diffail"]
OTHERS = ["true", "zero"]


@pytest.fixture
def fresh(monkeypatch):
    """The known reward models, with whatever the test adds to them forgotten afterwards."""
    monkeypatch.setattr(methods, "_BASES", methods.bases())
    yield
    plugins.load.cache_clear()


def parts(name):
    """A method's base by name and what its variant changes."""
    method = parse_method(name)
    return method.base.name, method.conditioned, method.bonus, method.obs_only


# Names


def test_every_base_has_its_variants_and_no_others():
    names = {
        base: {p + base + s for p in ("", "mbo-", "mcond-", "mconbo-") for s in ("", "-obs")} for base in IMITATORS
    }
    names |= {base: {base, f"mbo-{base}"} for base in OTHERS}
    assert set(methods.bases()) == set(names)
    for base, expected in names.items():
        assert {name for name in method_names() if parse_method(name).base.name == base} == expected
    assert len(method_names()) == len(set(method_names())) == 7 * 8 + 2 * 2
    assert method_names()[0] == "true"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("true", ("true", False, False, False)),
        ("mbo-true", ("true", False, True, False)),
        ("gail", ("gail", False, False, False)),
        ("mcond-gail", ("gail", True, False, False)),
        ("mbo-gail", ("gail", False, True, False)),
        ("mconbo-gail", ("gail", True, True, False)),
        ("airl-obs", ("airl", False, False, True)),
        ("mcond-giril-obs", ("giril", True, False, True)),
        ("mbo-pwil", ("pwil", False, True, False)),
        ("mconbo-maxent-obs", ("maxent", True, True, True)),
        ("mbo-zero", ("zero", False, True, False)),
    ],
)
def test_names_have_parts(name, expected):
    assert parts(name) == expected and name in method_names()
    assert methods.name_of(parse_method(name)) == name


@pytest.mark.parametrize(
    "name",
    [
        "mcond-true", "mconbo-true", "true-obs", "mbo-true-obs", "mcond-zero", "zero-obs", "mbo-mcond-gail",
        "mcond-mbo-gail", "mbo-mbo-gail", "gail-obs-obs", "obs-gail", "-obs", "mbo--obs", "mbo-", "vail-mbo", "gail ",
        "VAIL", "gail-Obs", "gial", "mconbo", "mconbo-", "gail-mbo", "",
    ],
)  # fmt: skip
def test_names_that_mean_nothing_are_refused(name):
    assert name not in method_names()
    with pytest.raises(ConfigError) as error:
        parse_method(name)
    sentence = str(error.value)
    assert f"'{name}'" in sentence and sentence.endswith(".") and "\n" not in sentence


@pytest.mark.parametrize(("name", "offered"), [("mcond-true", "mbo-true"), ("true-obs", "mbo-true"), ("gial", "gail")])
def test_a_refusal_says_what_there_is(name, offered):
    with pytest.raises(ConfigError, match=f"{offered}"):
        parse_method(name)


def test_descriptions_say_what_a_method_is():
    lines = {name: describe(name) for name in method_names()}
    assert len(set(lines.values())) == len(lines) and all("\n" not in line for line in lines.values())
    for name, line in lines.items():
        method = parse_method(name)
        assert line.startswith(method.base.summary)
        assert ("δ(s)" in line) == method.conditioned
        assert ("actions hidden" in line) == method.obs_only
        assert ("plus the measure bonus" in line) == method.bonus


# Models from elsewhere


def centre(config, widths):
    """Minus the distance to the demonstrations' mean, which it learns in small steps."""

    def joined(inputs):
        return jnp.concatenate([inputs.obs, inputs.action, inputs.proxy], axis=-1)

    def update(key, state, expert, policy):
        off = joined(expert).mean(axis=0) - state
        return state + 0.1 * off, {"off": jnp.linalg.norm(off)}

    return InputModel(
        init=lambda key, expert: jnp.zeros(widths.obs + widths.action + widths.proxy),
        reward=lambda state, memory, inputs, ended: (memory, -jnp.linalg.norm(joined(inputs) - state, axis=-1)),
        update=update,
    )


def test_a_new_model_gets_all_variants_and_trains(fresh):
    assert register("centre", "minus the distance to the middle of the demonstrations", signed=True)(centre) is centre
    added = [name for name in method_names() if parse_method(name).base.name == "centre"]
    assert added == method_names()[-8:] and "mconbo-centre-obs" in added
    rng = np.random.default_rng(0)
    expert, policy = steps_of(rng, shift=2.0), steps_of(rng)
    for name in added:
        method, model = parse_method(name), built(name)
        state = model.init(jax.random.key(0), demos_of(expert))
        seen = OBS + (0 if method.obs_only else ACTIONS) + (PROXIES if method.conditioned else 0)
        assert state.inner.shape == (seen,)
        offs = []
        for _ in range(20):
            state, info = model.update(jax.random.key(0), state, CONTEXT, demos_of(expert), policy)
            offs.append(float(info["off"]))
        on_expert, on_policy = (model.reward(state, (), CONTEXT, steps)[1] for steps in (expert, policy))
        assert on_expert.shape == (8, 16) and on_expert.mean() > on_policy.mean()
        assert offs[-1] < 0.2 * offs[0]


def test_a_model_gets_the_runs_configuration_and_the_widths_of_its_inputs(fresh):
    received = []

    def nosy(config, widths):
        received.append((config.method, config.ppo.gamma, widths))
        return centre(config, widths)

    register("nosy", "a model that remembers its arguments")(nosy)
    for name in ("nosy", "mconbo-nosy", "nosy-obs", "mcond-nosy-obs"):
        built(name, gamma=0.875)
    assert received == [
        ("nosy", 0.875, Inputs(OBS, ACTIONS, OBS, 0)),
        ("mconbo-nosy", 0.875, Inputs(OBS, ACTIONS, OBS, PROXIES)),
        ("nosy-obs", 0.875, Inputs(OBS, 0, OBS, 0)),
        ("mcond-nosy-obs", 0.875, Inputs(OBS, 0, OBS, PROXIES)),
    ]


def test_the_example_in_the_documentation_works(fresh):
    text = register.__doc__
    example = textwrap.dedent(text[text.index("        @register") : text.index("    Then ``qdil --import")])
    exec(example, {"register": register, "InputModel": InputModel, "jnp": jnp})
    rng = np.random.default_rng(0)
    expert, policy = steps_of(rng, time=2, envs=3), steps_of(rng, time=2, envs=3)
    model = built("mbo-nearest-obs")
    state = model.init(jax.random.key(0), demos_of(expert))
    state, _ = model.update(jax.random.key(0), state, CONTEXT, demos_of(expert), policy)
    _, rewards = model.reward(state, model.begin(state, 3), CONTEXT, policy)
    mean, std = CONTEXT.normaliser
    raw = np.asarray(demos_of(expert).obs, float)
    rows, steps = (raw - raw.mean(0)) / raw.std(0), (np.asarray(policy.obs, float) - mean) / std
    for t, e in np.ndindex(2, 3):
        assert rewards[t, e] == pytest.approx(-min(np.linalg.norm(steps[t, e] - row) for row in rows), rel=1e-3)


def test_a_model_without_inputs_has_no_variants_of_them(fresh):
    register("still", "a reward for nothing", imitates=False)(lambda config: None)
    assert [name for name in method_names() if "still" in name] == ["still", "mbo-still"]
    for name in ("mcond-still", "still-obs"):
        with pytest.raises(ConfigError, match="mbo-still"):
            parse_method(name)


def test_a_hyphen_in_a_name_is_no_variant(fresh):
    register("far-off", "a name of two words")(centre)
    assert parts("mconbo-far-off-obs") == ("far-off", True, True, True)
    assert parts("far-off") == ("far-off", False, False, False)


@pytest.mark.parametrize(("signed", "threshold"), [(True, -10.0 * 50), (False, 0.0)])
def test_an_archive_of_signed_rewards_starts_low(fresh, signed, threshold):
    register("centre", "a model", signed=signed)(centre)
    for name in ("centre", "mconbo-centre-obs"):
        assert make_config("walker2d", name, "smoke").ppga.threshold_min == threshold


@pytest.mark.parametrize("name", ["x-obs", "mbo-x", "mcond-x", "mconbo-x", "mbo-gail", "gail-obs"])
def test_names_that_look_like_variants_cannot_be_taken(fresh, name):
    with pytest.raises(ConfigError, match="variant"):
        register(name, "a model")(centre)
    assert name not in methods.bases()


def test_names_that_are_taken_stay_so(fresh):
    built_in = methods.bases()["gail"]
    with pytest.raises(ConfigError, match="already.*'gail'"):
        register("gail", "a model")(centre)
    assert methods.bases()["gail"] == built_in
    register("centre", "a model")(centre)
    register("centre", "a model")(centre)  # the same again, as when a module is imported twice, does no harm


@pytest.mark.parametrize("name", ["", "two words", "a/b", "../up", "Gail", "1st"])
def test_names_that_cannot_name_a_folder_are_refused(fresh, name):
    with pytest.raises(ConfigError, match="cannot name a reward model"):
        register(name, "a model")(centre)


def test_the_papers_come_first_whoever_registers_first(fresh):
    register("early", "a model")(centre)
    assert (method_names()[0], method_names()[-1]) == ("true", "mconbo-early-obs")
    assert list(methods.bases())[:-1] == [base.name for base in methods.BUILT_IN]
