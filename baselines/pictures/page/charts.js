// Curves of strain, friction and clearance against their limits, with a cursor that follows the slider.

const SVG = "http://www.w3.org/2000/svg";
const TALL = 132;
const ROOM = { left: 34, right: 8, top: 8, bottom: 18 };

function mark(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

/** Round numbers from low to high, some four of them. */
function ticks(low, high) {
  const raw = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9; k++) found.push(Number((k * step).toPrecision(6)));
  return found;
}

class Chart {
  /** key: of a motion's curves; wantedAbove: whether the goal is to come above the limit. */
  constructor(figure, key, wantedAbove, squeeze, onTime) {
    Object.assign(this, { key, wantedAbove, squeeze });
    this.svg = figure.querySelector("svg");
    this.readout = figure.querySelector(".now");
    this.lines = [];
    const point = (event) => {
      const box = this.svg.getBoundingClientRect();
      onTime(Math.min(1, Math.max(0, (event.clientX - box.left - ROOM.left) / (box.width - ROOM.left - ROOM.right))));
    };
    this.svg.addEventListener("pointerdown", (event) => {
      this.svg.setPointerCapture(event.pointerId);
      point(event);
    });
    this.svg.addEventListener("pointermove", (event) => { if (event.buttons) point(event); });
    new ResizeObserver(() => this.draw()).observe(this.svg);
  }

  /** lines: [{ name, colour, time, values, limit, text }], one a view. */
  set(lines) {
    this.lines = lines;
    this.draw();
  }

  draw() {
    const wide = this.svg.clientWidth;
    if (!wide || !this.lines.length) return;
    this.svg.replaceChildren();
    this.svg.setAttribute("viewBox", `0 0 ${wide} ${TALL}`);
    const finite = this.lines.flatMap((line) => line.values.filter((v) => typeof v === "number"));
    const limits = this.lines.map((line) => line.limit);
    let low = Math.min(0, ...finite, ...limits);
    let high = Math.max(...finite, ...limits);
    const room = high - low || 1;
    high += 0.14 * room;
    if (low < 0) low -= 0.08 * room;
    const [left, right, top, bottom] = [ROOM.left, wide - ROOM.right, ROOM.top, TALL - ROOM.bottom];
    this.x = (time) => left + time * (right - left);
    this.y = (value) => (value === Infinity || value === "inf" ? top : bottom - ((value - low) / (high - low)) * (bottom - top));
    mark(this.svg, "rect", { x: left, y: top, width: this.x(this.squeeze) - left, height: bottom - top, class: "squeeze" });
    for (const value of ticks(low, high)) {
      mark(this.svg, "line", { x1: left, x2: right, y1: this.y(value), y2: this.y(value), class: "grid" });
      mark(this.svg, "text", { x: left - 5, y: this.y(value) + 3.5, "text-anchor": "end" }, String(value).replace("-", "\u2212"));
    }
    mark(this.svg, "text", { x: left, y: TALL - 5 }, "closing");
    mark(this.svg, "text", { x: right, y: TALL - 5, "text-anchor": "end" }, "lifting \u2192");
    for (const limit of new Set(limits)) {
      mark(this.svg, "line", { x1: left, x2: right, y1: this.y(limit), y2: this.y(limit), class: this.wantedAbove ? "goal" : "limit" });
      const word = this.wantedAbove ? "in view above" : `limit ${limit}`;
      mark(this.svg, "text", { x: right, y: this.y(limit) - 4, "text-anchor": "end", class: this.wantedAbove ? "goal" : "limit" }, word);
    }
    for (const line of this.lines) {
      const points = line.values.map((v, k) => (v === null ? null : `${this.x(line.time[k]).toFixed(1)},${this.y(v).toFixed(1)}`));
      mark(this.svg, "polyline", { points: points.filter(Boolean).join(" "), class: "curve", stroke: line.colour });
    }
    this.cursor = mark(this.svg, "line", { y1: top, y2: bottom, class: "cursor" });
    this.dots = this.lines.map((line) => mark(this.svg, "circle", { r: 4, fill: line.colour, class: "dot" }));
    this.show(this.at ?? 0);
  }

  show(time) {
    this.at = time;
    if (!this.cursor) return;
    this.cursor.setAttribute("x1", this.x(time));
    this.cursor.setAttribute("x2", this.x(time));
    const said = this.lines.map((line, k) => {
      const value = valueAt(line.time, line.values, time);
      this.dots[k].setAttribute("cx", this.x(time));
      this.dots[k].setAttribute("cy", value === null ? -10 : this.y(value));
      return { colour: line.colour, text: value === null ? "\u2013" : line.text(value) };
    });
    this.readout.replaceChildren(...said.map(({ colour, text }) => {
      const word = document.createElement("b");
      word.style.setProperty("--plan", colour);
      word.textContent = text;
      return word;
    }));
  }
}
