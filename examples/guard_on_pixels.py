"""A guard whose only input is pictures: a disc goes through a gap of random height in a wall.

usage: guard_on_pixels.py [PICTURE [EPISODES]]

The guard uses slow features of positions in the pictures. Prints the guard's effect on a good and on a weak policy,
whose input is the state. Writes a PNG of a state outside: the picture, and the share of each pixel in the level.
"""

import sys

import matplotlib
import numpy as np

import dfr

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

SIDE, RADIUS, HALF_GAP, WALL = 32, 0.08, 0.16, 0.5
CENTRES = (np.arange(SIDE) + 0.5) / SIDE
COLUMNS, ROWS = np.meshgrid(CENTRES, CENTRES)


def picture(state, rng):
    """Returns a grey picture (1024,) of the state [x, y, gap], with noise, in light that varies by 20 %."""
    x, y, gap = state
    disc = np.clip((RADIUS - np.hypot(COLUMNS - x, ROWS - y)) * SIDE + 0.5, 0, 1)
    wall = np.clip((0.03 - abs(COLUMNS - WALL)) * SIDE + 0.5, 0, 1)
    wall = np.minimum(wall, np.clip((abs(ROWS - gap) - HALF_GAP) * SIDE + 0.5, 0, 1))
    clean = 60 + 120 * wall * (1 - disc) + 150 * disc
    seen = clean * rng.uniform(0.8, 1.2) + 0.03 * 255 * rng.normal(size=clean.shape)
    return np.clip(np.round(seen), 0, 255).astype(np.uint8).ravel()


def start(rng):
    return np.array([rng.uniform(0.08, 0.12), rng.uniform(0.2, 0.8), rng.uniform(0.25, 0.75)])


def act(state, rng, weak):
    """Steps towards the gap and, behind it, to the middle. The weak policy ignores the gap."""
    x, y, gap = state
    aim = gap if x < 0.55 and not weak else 0.5
    return np.array([0.025 * rng.uniform(0.9, 1.1), np.clip(0.25 * (aim - y), -0.03, 0.03) + 0.002 * rng.normal()])


def moved(state, action):
    return state + np.append(action, 0.0)


def hits(state):
    x, y, gap = state
    beside = max(abs(x - WALL) - 0.03, 0.0)
    return any(np.hypot(beside, max(s * (gap - y) + HALF_GAP, 0.0)) < RADIUS for s in (-1, 1)) or not 0 < y < 1


def demonstration(rng):
    while True:
        states, actions = [start(rng)], []
        while states[-1][0] < 0.9:
            actions.append(act(states[-1], rng, weak=False))
            states.append(moved(states[-1], actions[-1]))
        if not any(map(hits, states)):
            return np.array([picture(s, rng) for s in states]), np.array(actions)


def episode(seed, weak, guard):
    rng = np.random.default_rng(seed)
    state = start(rng)
    alarm = False
    passed = []
    if guard is not None:
        guard.reset(seed)
    for t in range(150):
        wish = action = act(state, rng, weak)
        if guard is not None:
            action, info = guard.filter(t, picture(state, rng), wish)
            alarm = alarm or info["alarm"]
            if info["mode"] == "halt":
                return "halted", alarm, np.mean(passed or [0])
        passed.append(np.array_equal(action, wish))
        state = moved(state, action)
        if hits(state):
            return "failed", alarm, np.mean(passed)
        if state[0] >= 0.9:
            return "completed", alarm, np.mean(passed)
    return "halted", alarm, np.mean(passed)


def main():
    path = sys.argv[1] if len(sys.argv) > 1 else "guard_on_pixels.png"
    episodes = int(sys.argv[2]) if len(sys.argv) > 2 else 10
    rng = np.random.default_rng(1)
    demonstrations = [demonstration(rng) for _ in range(60)]
    guard = dfr.Guard.fit(
        [pictures for pictures, _ in demonstrations],
        [actions for _, actions in demonstrations],
        layout={"image": (SIDE, SIDE)},
        features="points:image",
    )
    for row in guard.summary["components"]:
        print("{components:3} components: actions explained {explained:.2f}, inside {inside:.2f}".format(**row))
    print(guard.summary["components_reason"])
    print("strategy:", guard.settings["strategy"])
    guards = {"alone": None, "monitored": guard.with_settings(strategy="monitor"), "guarded": guard}
    completed = {}
    for policy in ("good", "weak"):
        for how, filtered in guards.items():
            runs = [episode(seed, policy == "weak", filtered) for seed in range(20000, 20000 + episodes)]
            ends = [(outcome, alarm) for outcome, alarm, _ in runs]
            outcomes = [outcome for outcome, _ in ends]
            passed = np.mean([share for *_, share in runs])
            completed[policy, how] = outcomes.count("completed")
            print(
                f"{policy} policy, {how}: {completed[policy, how]} of {episodes} completed,"
                f" {sum(alarm for outcome, alarm in ends if outcome == 'completed')} of them with an alarm;"
                f" {outcomes.count('failed')} failed, {ends.count(('failed', True))} with an alarm;"
                f" {passed:.0%} of the actions passed"
            )

    # A state in front of the wall, far from all demonstrations.
    outside = picture([0.4, 0.2, 0.7], rng)
    pixels = guard.attribution(outside[None].astype(float))[0].reshape(SIDE, SIDE)
    figure, axes = plt.subplots(1, 2, figsize=(6, 3.2))
    axes[0].imshow(outside.reshape(SIDE, SIDE), cmap="gray", vmin=0, vmax=255)
    axes[0].set_title("picture")
    most = abs(pixels).max()
    axes[1].imshow(pixels, cmap="PuOr", vmin=-most, vmax=most)
    axes[1].set_title(f"share of -l = {pixels.sum():.1f}")
    for ax in axes:
        ax.set_axis_off()
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    print(path)
    return completed


if __name__ == "__main__":
    done = main()
    assert done["good", "guarded"] >= done["good", "alone"], done
    assert done["weak", "guarded"] > done["weak", "alone"], done
