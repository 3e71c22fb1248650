"""The colours of methods are the same in all pictures."""

import pytest
from result_files import script

from experiments import pictures

BESTS = "best go1.laptop.best best-g new-g".split()
LOOKS = {  # a script -> where it says how its methods look
    "02_brax/plot": ["LOOKS"],
    "04_laptop/table": ["DRAWN"],
    "05_playground/plot": ["LOOKS"],
    "21_less/plot": ["RUNS"],
    "24_off_policy/plot": ["RUNS", "TODAY", "SETTINGS"],
    "25_humanoid/plot": ["LOOKS"],
    "27_few/plot": ["METHODS", "COLOURS"],
    "28_rough/plot": ["LOOKS"],
    "30_row_cost/plot": ["LOOKS"],
}


def colour(look) -> str:
    """Of a look, which is a colour or has one."""
    (found,) = [
        part for part in ([look] if isinstance(look, str) else look) if str(part)[:1] == "#"
    ]
    return found


def test_ppo_alone_and_best_have_colours_of_their_own_in_all_pictures():
    """PPO-16 and PPO-24 are the paper's."""
    drawn = {"ppo": 0, "best": 0}
    for name, tables in LOOKS.items():
        for look_of in (getattr(script(name), table) for table in tables):
            for run, look in look_of.items():
                words = run.lower().removeprefix("go1.laptop.")
                if words.startswith("ppo") and not words.startswith(("ppo16", "ppo24")):
                    assert colour(look) == pictures.PPO, (name, run)
                    drawn["ppo"] += 1
                elif run in BESTS:
                    assert colour(look) == pictures.BEST, (name, run)
                    drawn["best"] += 1
                else:
                    assert colour(look) not in (pictures.PPO, pictures.BEST), (name, run)
    assert drawn == {"ppo": 22, "best": 9}
    assert pictures.COLOURS["best"] == pictures.BEST
    assert pictures.COLOURS["ppo16"] == pictures.BLACK


def test_several_settings_of_ppo_differ_by_dashes_and_marks():
    for name, tables in LOOKS.items():
        for table in tables:
            looks = getattr(script(name), table)
            ppo = [look for look in looks.values() if colour(look) == pictures.PPO]
            assert len({str(look[1:]) for look in ppo}) == len(ppo)


def test_a_g1s_settings_with_three_seeds_have_bands_and_others_a_line_a_seed(drawn):
    """Of those alone on a card; a legend does not lie on curves."""
    plt = pytest.importorskip("matplotlib.pyplot")
    plot = script("25_humanoid/plot")
    counts = {name: len(seeds) for name, seeds in plot.alone().items()}
    assert counts == dict(zip(plot.LOOKS, (10, 2, 1, 3, 1, 3, 1), strict=True))
    plot.main()
    axes = plt.gcf().axes
    assert drawn == ["curves"] and not any(axis.get_legend() for axis in axes)
    for axis in axes[3:]:
        curves = [line for line in axis.lines if len(line.get_xdata()) > 2]
        thin = [line for line in curves if line.get_linewidth() < 1]
        assert (len(axis.collections), len(curves) - len(thin), len(thin)) == (3, 3, 5)
    assert all(len(axis.collections) == 2 for axis in axes[:3])
