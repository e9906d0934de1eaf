// Picks a goal in the picture, by pointer or by keys. Nothing is sent before release or Enter; Escape cancels.

import { pixelAt } from "./overlay.js";

const DRAG_PX = 8; // a pointer that moves farther drags, and sets no goal
const STEP = 1 / 160; // of the picture's width
const LARGE_STEP = 10; // steps
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class GoalPicker {
  /** Where a goal would be set, {u, v} in pixels of the picture; null where none would. */
  target = null;
  #canvas;
  #pressed = null; // [x, y] on the screen
  #ask;

  /**
   * `size()` gives the picture's [width, height], or null where no goal may be set; `from()` a pixel for the crosshair
   * to begin at, or null; `onGoal(pixel)` sets a goal; `onChange()` is called when `target` has changed.
   */
  constructor(canvas, { size, from, onGoal, onChange }) {
    this.#canvas = canvas;
    this.#ask = { size, from, onGoal, onChange };
    canvas.addEventListener("pointerdown", (event) => this.#press(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", () => this.#pressed && this.#send());
    // A touch that becomes a scroll or a pinch is cancelled by the browser.
    for (const name of ["pointercancel", "pointerleave"]) {
      canvas.addEventListener(name, () => this.#pressed && this.cancel());
    }
    canvas.addEventListener("blur", () => !this.#pressed && this.cancel());
    canvas.addEventListener("keydown", (event) => this.#key(event));
    window.addEventListener("keydown", (event) => event.key === "Escape" && this.cancel());
  }

  /** Whether a pointer holds the target, rather than keys. */
  get pressed() {
    return this.#pressed !== null;
  }

  /** Forget the target. */
  cancel() {
    this.#pressed = null;
    this.#put(null);
  }

  #put(pixel) {
    if (pixel === null && this.target === null) return;
    this.target = pixel;
    this.#ask.onChange();
  }

  #send() {
    const goal = this.target;
    this.cancel();
    if (goal) this.#ask.onGoal(goal);
  }

  #press(event) {
    const size = this.#ask.size();
    this.cancel(); // also where a second finger comes down
    if (!size || !event.isPrimary || event.button !== 0) return;
    const pixel = pixelAt(event, this.#canvas, size);
    if (!pixel) return;
    this.#pressed = [event.clientX, event.clientY];
    this.#put(pixel);
  }

  #move(event) {
    if (!this.#pressed || !event.isPrimary) return;
    const [x, y] = this.#pressed;
    if (Math.hypot(event.clientX - x, event.clientY - y) > DRAG_PX) this.cancel();
  }

  #key(event) {
    const size = this.#ask.size();
    if (!size || event.ctrlKey || event.altKey || event.metaKey) return;
    const arrow = ARROWS[event.key];
    if (event.key === "Enter" && this.target) this.#send();
    else if (arrow) this.#put(this.#stepped(arrow, event.shiftKey, size));
    else return;
    event.preventDefault();
  }

  /** The first arrow only shows the crosshair; those that follow move it. */
  #stepped([right, down], large, [width, height]) {
    if (!this.target) return this.#ask.from() ?? { u: width / 2, v: height / 2 };
    const step = width * STEP * (large ? LARGE_STEP : 1);
    return {
      u: Math.min(Math.max(this.target.u + right * step, 0), width - 1),
      v: Math.min(Math.max(this.target.v + down * step, 0), height - 1),
    };
  }
}
