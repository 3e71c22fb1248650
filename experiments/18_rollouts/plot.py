"""overview, model and tail as PNG: the paper's figures 1 to 3, drawn as their captions say.

    python experiments/18_rollouts/plot.py

The rows of `overview` are those of schedule.py, the curves of `tail` those of results/rows.csv.
"""

from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.tasks.velocity import observe
from experiments import paper, pictures

REAL, LENGTH = 4, 16  # rows of an iteration of `best`: real, of its tail
TAILS = (0, 2, 4, 6)  # iterations whose tails are shown and measured: every other one
KEPT = TAILS[-1] + 1 + LENGTH // REAL  # iterations in results/: until the last tail ends
GREY, ORANGE, BLUE, INK = pictures.GREY, pictures.VERMILION, pictures.BLUE, "0.2"
ROWS = observe.slices(12)
CURVES = {  # column of rows.csv -> number of the state, label
    "speed": (ROWS["linear_velocity"].start, "velocity ahead (m/s)"),
    "thigh": (ROWS["joint_position"].start + 1, "first leg, thigh (rad)"),
    "calf": (ROWS["joint_position"].start + 2, "first leg, calf (rad)"),
}


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    columns = paper.read_one(out / "results" / "rows.csv")
    found = paper.read_one(out / "results" / "distance.csv")
    far = [{n: column[k - 1] for n, column in found.items()} for k in (1, 4, 8, 16)]
    paper.write(out / "results.csv", far)
    paper.show(far, far[0])
    draw_overview(out / "overview")
    draw_model(out / "model")
    draw_tail(columns, out / "tail")


def steady(buffers) -> np.ndarray:
    """Which robots `[R]` neither end an episode nor get another command in any of these rollouts."""
    alive = np.all([((b.discount == 1) & (b.truncation == 0))[:REAL].all(0) for b in buffers], 0)
    commands = np.stack([b.obs[..., ROWS["command"]] for b in buffers])
    return alive & (np.ptp(commands, axis=(0, 1)) == 0).all(-1)


def rows(buffers, dt: float) -> list[dict]:
    """A row a control step, of the steady robot with the fastest command ahead.

    `time` (s) is that of physics: the tail of an iteration overlaps the real rows of the next four.
    """
    ahead = buffers[0].obs[0, :, ROWS["command"].start]
    robot, out = int(np.argmax(np.where(steady(buffers), ahead, -np.inf))), []
    for i, buffer in enumerate(buffers):
        for t in range(len(buffer.reward)):
            time, synthetic = (i * REAL + t + 1) * dt, int(t >= REAL)
            cells = {"rollout": i, "step": t, "time": time, "synthetic": synthetic}
            cells |= {n: float(buffer.next_prop[t, robot, k]) for n, (k, _) in CURVES.items()}
            out.append({n: f"{v:.5g}" for n, v in cells.items()})
    return out


def distance(buffers) -> list[dict]:
    """How far row k of the tails is from where physics went: root mean square, steady robots and tails.

    "still" is the same for repeating the last real state. Actions differ too: their noise is another one.
    """
    states = np.stack([b.next_prop for b in buffers])[:, :, steady(buffers)]  # [I, N, R, P]
    first = np.array(TAILS)
    real, tails, out = states[:, :REAL], states[first, REAL:], []
    for k in range(tails.shape[1]):
        ahead, row = divmod(k, REAL)
        went = real[first + 1 + ahead, row]  # [TAILS, R, P]
        cells: dict = {"row": k + 1, "robots": states.shape[2]}
        for name, (n, _) in CURVES.items():
            for label, guess in (("tail", tails[:, k]), ("still", real[first, -1])):
                cells[f"{name}_{label}"] = f"{np.sqrt(np.mean((guess - went)[..., n] ** 2)):.4g}"
        out.append(cells)
    return out


def box(axis, x, y, text, colour="white", wide=1.0, high=0.62, **more):
    """A box with its text about (x, y)."""
    from matplotlib.patches import FancyBboxPatch

    shape = dict(
        boxstyle=f"round,pad=0,rounding_size={min(0.08, wide / 4)}", facecolor=colour, edgecolor=INK
    )
    axis.add_patch(FancyBboxPatch((x - wide / 2, y - high / 2), wide, high, linewidth=1, **shape))
    axis.text(x, y, text, **{"ha": "center", "va": "center", "fontsize": 9} | more)


def arrow(axis, start, end):
    """A straight arrow."""
    how = dict(arrowstyle="-|>", color=INK, shrinkA=0, shrinkB=0)
    axis.annotate("", end, start, arrowprops=how)


def blank(axis, across, up) -> None:
    """An axis to draw on, without ticks; `across` and `up` are its limits."""
    axis.set(xlim=across, ylim=up, aspect="equal")
    axis.axis("off")


def draw_overview(path: Path) -> None:
    """Figure 1: the pipeline of an iteration, and its rows over the ramps of the paper and of `best`."""
    page, axes = pictures.figure(2, 2, 5.2, height_ratios=(1.4, 1))
    axis, small = axes[0, 0], {"fontsize": 9}
    axes[0, 1].remove()
    axis.set_subplotspec(axis.get_gridspec()[0, :])  # as wide as the page
    blank(axis, (0, 12.4), (-0.3, 3.3))
    box(axis, 1.2, 2.2, "physics $p$\n(MuJoCo)", wide=1.9, high=0.9)
    for n in range(20):
        colour = GREY if n < REAL else ORANGE
        box(axis, 3.3 + 0.2 * n, 2.2, "", colour, wide=0.15, high=0.55)
    axis.text(3.2, 2.55, f"{REAL} real", **small, color=INK)
    axis.text(5.95, 2.55, "tail: 16 synthetic rows", ha="center", **small, color=ORANGE)
    box(axis, 3.9, 0.75, "fit $f_\\theta$\n$\\mathcal{L}_{model}$", wide=1.5, high=0.9)
    box(axis, 6.3, 0.75, "model $f_\\theta$\nas physics", "#fbe6d3", wide=1.5, high=0.9)
    box(axis, 9.2, 2.2, "GAE, PPO\n$\\mathcal{L}_{CLIP}$", wide=1.7, high=0.9)
    box(axis, 11.4, 2.2, "policy $\\pi$", wide=1.3, high=0.9)
    arrow(axis, (2.15, 2.2), (3.2, 2.2))
    arrow(axis, (3.9, 1.9), (3.9, 1.22))
    arrow(axis, (4.65, 0.75), (5.55, 0.75))
    arrow(axis, (6.3, 1.22), (6.3, 1.9))
    arrow(axis, (7.35, 2.2), (8.35, 2.2))
    arrow(axis, (10.05, 2.2), (10.75, 2.2))
    axis.plot([11.4, 11.4, 1.2, 1.2], [1.72, -0.2, -0.2, 1.2], color=INK, linewidth=1)
    arrow(axis, (1.2, 1.2), (1.2, 1.72))
    arrow(axis, (6.3, -0.2), (6.3, 0.28))
    axis.text(8.9, -0.14, "acts in physics and in the model", ha="center", va="bottom", **small)
    text = "three rounds an iteration:\nnew tail, new update"
    axis.text(7.2, 0.75, text, va="center", color=INK, **small)
    anchor = 3.3 + 0.2 * (REAL - 0.5)
    axis.plot(
        [anchor, anchor, 1.2, 1.2], [2.5, 3.1, 3.1, 2.95], color=INK, linewidth=1, linestyle="--"
    )
    arrow(axis, (1.2, 2.95), (1.2, 2.68))
    text = "anchor: the tail begins here, and so does the next rollout"
    axis.text(anchor + 0.12, 3.1, text, va="center", **small, color=INK)
    for axis, variant, who in zip(
        axes[1], ("dyna4", "best"), ("the paper's ramp", "ours"), strict=True
    ):
        config = config_lib.load(f"configs/go1.py:{variant}")
        steps, rows = schedule.table(config), config.rollout.horizon
        i = np.arange(1, len(steps) + 1)
        axis.stackplot(
            i,
            rows - steps,
            steps,
            colors=(GREY, ORANGE),
            step="mid",
            labels=("simulated", "synthetic"),
        )
        axis.set(
            xlim=(1, len(i)), ylim=(0, 24), xlabel="iteration", yticks=(0, 4, 8, 12, 16, 20, 24)
        )
        axis.set_title(f"{variant}, {who}: {rows} rows", loc="left")
        axis.grid(visible=False)
    axes[1, 0].set_ylabel("rows of a rollout")
    axes[1, 0].legend(loc="lower right", framealpha=1)
    pictures.save(page, path)


def draw_model(path: Path) -> None:
    """Figure 2: real rows feed the model's loss; policy and model write the tail by turns."""
    page, axes = pictures.figure(1, 1, 3.4)
    axis = axes[0, 0]
    blank(axis, (0, 13.2), (0.5, 4.6))
    names = "$o_0$ $o_1$ $\\cdots$ $o_{N_r}$ $\\hat{o}_{N_r+1}$ $\\cdots$ $\\hat{o}_N$".split()
    at = [0.9 + 1.9 * n for n in range(len(names))]
    for n, (x, name) in enumerate(zip(at, names, strict=True)):
        box(axis, x, 2.9, name, "#fbe6d3" if n > 3 else "#dddddd", wide=0.95)
        if n + 1 < len(at):
            maker, colour = ("$f_\\theta$", ORANGE) if n >= 3 else ("$p$", INK)
            arrow(axis, (x + 0.48, 2.9), (at[n + 1] - 0.48, 2.9))
            axis.text(x + 0.95, 2.8, maker, color=colour, fontsize=11, ha="center", va="top")
            box(axis, x + 0.95, 4.25, "$\\pi$", wide=0.5, high=0.5)
            arrow(axis, (x + 0.25, 3.22), (x + 0.75, 4.0))
            arrow(axis, (x + 0.95, 4.0), (x + 0.95, 2.93))
            axis.text(x + 1.07, 3.5, "$a$", fontsize=9)
    brace(axis, at[0] - 0.48, at[3] + 0.2, 2.25)
    brace(axis, at[3] + 0.6, at[6] - 0.6, 2.25)
    left, right = (at[0] + at[3] - 0.28) / 2, (at[3] + at[6]) / 2
    box(axis, left, 1.0, "rollout buffer: $o, a, r, o'$ of the real rows", wide=4.6, high=0.7)
    loss = "$\\mathcal{L}_{model}$ = Huber$(f_\\theta(o, a), (o'-o, r))$"
    box(axis, right, 1.0, loss, wide=4.4, high=0.7)
    arrow(axis, (left, 2.15), (left, 1.37))
    arrow(axis, (left + 2.3, 1.0), (right - 2.2, 1.0))
    arrow(axis, (right, 1.37), (right, 2.15))
    axis.text(left + 0.15, 1.75, "simulated", fontsize=9, color=INK, va="center")
    text = "tail: policy and model by turns"
    axis.text(right + 0.15, 1.75, text, fontsize=9, color=ORANGE, va="center")
    pictures.save(page, path)


def brace(axis, left: float, right: float, y: float) -> None:
    """A bracket below the boxes from `left` to `right`."""
    middle, across = (left + right) / 2, [left, left, right, right]
    axis.plot(across, [y + 0.15, y, y, y + 0.15], color=INK, linewidth=1)
    axis.plot([middle, middle], [y, y - 0.1], color=INK, linewidth=1)


def draw_tail(get, path: Path) -> None:
    """Figure 3: successive rollouts of one robot; each goes on from the last state of physics."""
    page, axes = pictures.figure(len(CURVES), 1, 6.4, sharex=True)
    real = get["synthetic"] == 0
    for axis, (name, (_, label)) in zip(axes[:, 0], CURVES.items(), strict=True):
        axis.plot(
            get["time"][real], get[name][real], ".-", color=GREY, linewidth=3, label="physics"
        )
        for n, i in enumerate(TAILS):
            tail = (get["rollout"] == i) & (get["step"] >= REAL - 1)
            x, y, k = get["time"][tail], get[name][tail], n % 2
            text = (
                f"{('first and third', 'second and fourth')[k]} tail of the model" if n < 2 else ""
            )
            style = dict(color=(ORANGE, BLUE)[k], marker="s^"[k], linestyle=("-", (0, (4, 1.2)))[k])
            axis.plot(x, y, linewidth=1.4, markersize=3.5, label=text, **style)
            text = "anchor: the next rollout begins here, too" if n == 0 else ""
            axis.plot(x[0], y[0], "o", color=INK, markersize=7, fillstyle="none", label=text)
        axis.set_ylabel(label)
    axes[-1, 0].set_xlabel("time of physics (s)")
    text = f"One Go1, rollouts of best: {REAL} real rows and a tail of {LENGTH}; every other tail is shown"
    pictures.head(page, text)
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, path)


if __name__ == "__main__":
    main()
