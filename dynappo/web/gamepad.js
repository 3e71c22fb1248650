// A gamepad presses the page's keys: viser has none of its own. Sticks steer while they are held.
if (!window.pads) {
  const press = (key) => ["keydown", "keyup"].forEach((kind) => document.body.dispatchEvent(
    new KeyboardEvent(kind, { key, code: key === " " ? "Space" : "Key" + key.toUpperCase(), bubbles: true })));
  const buttons = [" ", "x", "r", "f", , , , , , "p"], held = new Set();
  window.pads = setInterval(() => {
    for (const pad of navigator.getGamepads()) {
      if (!pad) continue;
      const [left, ahead, turn] = [-pad.axes[0], -pad.axes[1], -(pad.axes[2] || 0)];
      for (const [value, more, less] of [[ahead, "i", "k"], [left, "u", "o"], [turn, "j", "l"]])
        if (Math.abs(value) > 0.4) press(value > 0 ? more : less);
      pad.buttons.forEach((button, i) => {
        const id = pad.index + "," + i;
        if (button.pressed && !held.has(id) && buttons[i]) press(buttons[i]);
        held[button.pressed ? "add" : "delete"](id);
      });
    }
  }, 120);
}
