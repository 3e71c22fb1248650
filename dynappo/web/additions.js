// What viser's page lacks: a gamepad, room for the robot on a phone, notes that go away, quiet legends.
if (!window.pads) {
  // A gamepad presses the page's keys. Sticks steer while they are held.
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

  // On a phone the panel covers the lower part of the window, and the robot has what is above it.
  const style = document.createElement("style");
  style.textContent = `@media (max-width: 576px) {
    .mantine-Paper-root[style*="position: fixed"] { left: 0; right: 0; width: auto !important; max-height: 50% !important; }
    .mantine-Paper-root[style*="position: fixed"] .mantine-ScrollArea-content > div { width: 100% !important; }
  }
  /* A plot's legend has values of where the mouse is. Without a mouse in the plot it would say "--". */
  .uplot:not(:has(.u-over:hover)) .u-legend .u-value { display: none; }
  .uplot:not(:has(.u-over:hover)) .u-legend .u-series > th::after { content: "" !important; }`;
  document.head.append(style);
  const since = new Map();
  setInterval(() => {
    const fixed = document.querySelector('.mantine-Paper-root[style*="position: fixed"]');
    const view = document.querySelector("[data-dock-root]");
    const height = fixed && fixed.getBoundingClientRect().left === 0 ? `${fixed.getBoundingClientRect().top}px` : "100%";
    if (view && view.style.height !== height) view.style.height = height;
    for (const note of document.querySelectorAll(".mantine-Notification-root")) {
      if (!since.has(note)) since.set(note, Date.now());
      else if (Date.now() - since.get(note) > 8000) note.querySelector("button")?.click();
    }
  }, 300);
}
