// The part of the image that is shown: by buttons, by Ctrl and the wheel or two fingers, by dragging where it is enlarged. A tap asks.
const MOST = 16;
const TAP_PX = 6;

export class Zoom {
  // picture : the element that shows the image; changed : called with the part [x, y, width, height] in px; tapped : with a pixel.
  constructor(picture, changed, tapped) {
    Object.assign(this, { picture, changed, tapped, size: [1, 1], part: [-0.5, -0.5, 1, 1], fingers: new Map(), moved: 0 });
    picture.addEventListener("pointerdown", (event) => this.#down(event));
    picture.addEventListener("pointermove", (event) => this.#move(event));
    for (const kind of ["pointerup", "pointercancel"]) picture.addEventListener(kind, (event) => this.#up(event));
    picture.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // the wheel alone scrolls the page
      event.preventDefault();
      this.by(Math.exp(-event.deltaY / 300), this.pixelAt(event));
    }, { passive: false });
  }

  get factor() { return this.size[0] / this.part[2]; }

  fit([width, height]) {
    if (width === this.size[0] && height === this.size[1]) return;
    this.size = [width, height];
    this.#show([-0.5, -0.5, width, height]);
  }

  // Enlarge by a factor about a pixel, which stays where it is; the middle of what is shown unless given.
  by(factor, about = [this.part[0] + this.part[2] / 2, this.part[1] + this.part[3] / 2]) {
    const k = Math.min(MOST, Math.max(1, this.factor * factor)) / this.factor;
    const [x, y, width, height] = this.part;
    this.#show([about[0] - (about[0] - x) / k, about[1] - (about[1] - y) / k, width / k, height / k]);
  }

  whole() { this.#show([-0.5, -0.5, ...this.size]); }

  pixelAt({ clientX, clientY }) {
    const frame = this.picture.getBoundingClientRect();
    const [x, y, width, height] = this.part;
    return [x + ((clientX - frame.left) / frame.width) * width, y + ((clientY - frame.top) / frame.height) * height];
  }

  #show([x, y, width, height]) {
    const within = (low, length, all) => Math.min(Math.max(low, -0.5), all - 0.5 - length);
    this.part = [within(x, width, this.size[0]), within(y, height, this.size[1]), width, height];
    this.picture.classList.toggle("enlarged", this.factor > 1);
    this.changed(this.part, this.factor);
  }

  #down(event) {
    if (event.target.closest("button")) return;
    if (!this.fingers.size) this.moved = 0;
    this.fingers.set(event.pointerId, event);
    if (this.factor > 1) this.picture.setPointerCapture(event.pointerId);
  }

  #move(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const others = [...this.fingers.values()].filter((one) => one.pointerId !== event.pointerId);
    this.moved += Math.hypot(event.clientX - before.clientX, event.clientY - before.clientY);
    const [from, to] = [this.pixelAt(before), this.pixelAt(event)];
    this.fingers.set(event.pointerId, event);
    if (others.length === 1) {
      const apart = (one) => Math.hypot(one.clientX - others[0].clientX, one.clientY - others[0].clientY);
      this.moved += TAP_PX;
      this.by(apart(event) / Math.max(apart(before), 1), this.pixelAt(others[0]));
    } else if (this.factor > 1) this.#show([this.part[0] + from[0] - to[0], this.part[1] + from[1] - to[1], this.part[2], this.part[3]]);
  }

  #up(event) {
    const known = this.fingers.delete(event.pointerId);
    if (known && event.type === "pointerup" && !this.fingers.size && this.moved < TAP_PX) this.tapped(this.pixelAt(event));
  }
}
