/* Zoom and hover of a page's figures; the page is complete without it. See report/svg.py for the data it reads. */
(() => {
  const NS = "http://www.w3.org/2000/svg", HREF = "http://www.w3.org/1999/xlink";
  const make = (name, attributes, parent) => {
    const one = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
    return parent.appendChild(one);
  };
  const raised = (text) => [...text].map((c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]).join("");
  const number = (value, digits = 4) => {
    if (value === 0 || (Math.abs(value) >= 1e-3 && Math.abs(value) < 1e5)) return String(+value.toPrecision(digits)).replace("-", "−");
    const [mantissa, power] = value.toExponential(digits - 1).split("e");
    return `${+mantissa}·10${raised(String(+power))}`.replace("-", "−");
  };

  /* One axis: its data limits, its ends in the drawing, and the part that is shown, as a scale and a shift of the drawing. */
  class Axis {
    constructor(info, from, to) { Object.assign(this, info, { from, to, scale: 1, shift: 0 }); this.log = info.kind === "log"; this.fixed = info.kind === "names"; }
    value(at) {
      const share = ((at - this.shift) / this.scale - this.from) / (this.to - this.from), [a, b] = this.limits;
      return this.log ? a * Math.pow(b / a, share) : a + share * (b - a);
    }
    at(value) {
      const [a, b] = this.limits, share = this.log ? Math.log(value / a) / Math.log(b / a) : (value - a) / (b - a);
      return (this.from + share * (this.to - this.from)) * this.scale + this.shift;
    }
    show(one, other) { /* two places in the drawing as it is now become the ends */
      if (this.fixed) return;
      const low = Math.min(this.from, this.to), high = Math.max(this.from, this.to);
      const first = (Math.max(Math.min(one, other), low) - this.shift) / this.scale, last = (Math.min(Math.max(one, other), high) - this.shift) / this.scale;
      this.scale = Math.min((high - low) / Math.max(last - first, 1e-9), 1e5);
      this.shift = low - first * this.scale;
      if (this.scale <= 1.0001) { this.scale = 1; this.shift = 0; }
    }
    factor(by) {
      const low = Math.min(this.from, this.to), high = Math.max(this.from, this.to), scale = Math.max(this.scale * by, 1);
      const middle = ((low + high) / 2 - this.shift) / this.scale, shift = (low + high) / 2 - middle * scale;
      if (this.fixed) return;
      this.scale = scale; this.shift = Math.min(low - low * scale, Math.max(high - high * scale, shift));
    }
    ticks() {
      const [a, b] = [this.value(this.from), this.value(this.to)].sort((one, other) => one - other), found = [];
      if (this.log && b / a > 8) {
        for (let p = Math.floor(Math.log10(a)); p <= Math.log10(b); p++)
          for (const m of b / a > 1e3 ? [1] : [1, 2, 5]) if (m * 10 ** p >= a && m * 10 ** p <= b) found.push(m * 10 ** p);
        return found;
      }
      const rough = (b - a) / 6, size = 10 ** Math.floor(Math.log10(rough)), step = size * ([1, 2, 5].find((m) => m * size >= rough) || 10);
      for (let k = Math.ceil(a / step); k * step <= b; k++) found.push(+(k * step).toPrecision(12));
      return found;
    }
  }

  class Panel {
    constructor(svg, info) {
      const find = (id) => svg.querySelector(`[id="${svg.dataset.name}.${id}"]`), [left, bottom, right, top] = info.box;
      this.box = { left, bottom, right, top };
      this.x = new Axis(info.x, left, right); this.y = new Axis(info.y, bottom, top);
      this.texts = info.texts.map(([id, x, y]) => [find(id), x, y]).filter(([one]) => one);
      this.parts = []; this.series = [];
      const points = {};
      for (const id of info.moved) {
        const group = find(id);
        if (!group) continue;
        const clipped = group.querySelector("[clip-path]"), spots = points[id] = [];
        if (clipped) { const clip = clipped.getAttribute("clip-path"); group.querySelectorAll("[clip-path]").forEach((one) => one.removeAttribute("clip-path")); group.setAttribute("clip-path", clip); }
        for (const one of group.querySelectorAll("path, use, image")) {
          if (one.closest("defs")) continue;
          const x = +one.getAttribute("x"), y = +one.getAttribute("y"), mark = one.tagName === "use" && !(x === 0);
          this.parts.push({ one, x, y, mark, before: one.getAttribute("transform") || "" });
          one.setAttribute("vector-effect", "non-scaling-stroke");
          if (mark) spots.push([x, y]);
          else if (one.tagName === "path") for (const [, a, b] of one.getAttribute("d").matchAll(/(-?[\d.]+(?:e-?\d+)?) (-?[\d.]+(?:e-?\d+)?)/g)) spots.push([+a, +b]);
        }
      }
      for (const [id, label] of info.series) if (points[id] && points[id].length) this.series.push({ label, spots: points[id] });
      this.sides = [["x", find(`${info.id}x`)], ["y", find(`${info.id}y`)]].map(([name, group]) => {
        const ticks = group ? [...group.children].filter((one) => /tick_/.test(one.id)) : [];
        return { axis: this[name], name, group, ticks, own: [] };
      });
    }
    holds([x, y]) { return x >= this.box.left && x <= this.box.right && y >= this.box.top && y <= this.box.bottom; }
    draw() {
      const { x, y } = this, moved = (px, py) => [px * x.scale + x.shift, py * y.scale + y.shift];
      for (const { one, x: px, y: py, mark, before } of this.parts) {
        if (mark) { const [a, b] = moved(px, py); one.setAttribute("x", a); one.setAttribute("y", b); }
        else one.setAttribute("transform", `matrix(${x.scale} 0 0 ${y.scale} ${x.shift} ${y.shift}) ${before}`);
      }
      for (const [one, px, py] of this.texts) {
        const [a, b] = moved(px, py);
        one.setAttribute("transform", `translate(${a - px} ${b - py})`);
        one.style.display = this.holds([a, b]) ? "" : "none";
      }
      for (const side of this.sides) {
        const zoomed = side.axis.scale > 1, model = side.ticks.find((one) => one.querySelector("text"));
        side.own.forEach((one) => one.remove()); side.own = [];
        side.ticks.forEach((one) => { one.style.display = zoomed && model ? "none" : ""; });
        if (!zoomed || !model) continue;
        const use = model.querySelector("use"), start = use ? +use.getAttribute(side.name) : 0;
        for (const value of side.axis.ticks()) {
          const tick = model.cloneNode(true), by = side.axis.at(value) - start;
          tick.removeAttribute("id"); tick.querySelectorAll("[id]").forEach((one) => { if (!one.closest("defs")) one.removeAttribute("id"); });
          tick.style.display = ""; tick.setAttribute("transform", side.name === "x" ? `translate(${by} 0)` : `translate(0 ${by})`);
          tick.querySelector("text").textContent = number(value);
          side.own.push(side.group.appendChild(tick));
        }
      }
    }
    nearest([px, py]) {
      let best = null, least = 900;
      for (const { label, spots } of this.series) for (const [x, y] of spots) {
        const a = x * this.x.scale + this.x.shift, b = y * this.y.scale + this.y.shift, square = (a - px) ** 2 + (b - py) ** 2;
        if (square < least && this.holds([a, b])) { least = square; best = { label, x: a, y: b }; }
      }
      return best;
    }
  }

  const view = (svg) => {
    const panels = JSON.parse(svg.dataset.axes).map((info) => new Panel(svg, info)), figure = svg.closest("figure");
    if (!panels.length || !figure) return;
    const title = svg.querySelector("title");
    svg.removeAttribute("aria-labelledby"); svg.setAttribute("aria-label", title.textContent); title.remove(); /* no tooltip over the readout */
    const dot = make("circle", { r: 4, fill: "none", stroke: "#23272e", "stroke-width": 1.2, visibility: "hidden" }, svg);
    const frame = make("rect", { fill: "#0072b2", "fill-opacity": 0.12, stroke: "#0072b2", visibility: "hidden" }, svg);
    const bar = document.createElement("div"), note = document.createElement("span");
    bar.className = "viewer"; note.className = "readout"; note.textContent = "drag to zoom, double-click to see all";
    const redraw = () => panels.forEach((panel) => panel.draw());
    const alike = (panel) => panels.filter((one) => String(one.x.limits) === String(panel.x.limits) && one.x.kind === panel.x.kind && one.box.left === panel.box.left);
    const reset = () => { panels.forEach(({ x, y }) => { x.scale = y.scale = 1; x.shift = y.shift = 0; }); redraw(); };
    const save = () => {
      const copy = svg.cloneNode(true);
      copy.querySelectorAll(":scope > circle, :scope > rect").forEach((one) => one.remove());
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" }));
      link.download = `${svg.dataset.name}.svg`; link.click(); URL.revokeObjectURL(link.href);
    };
    const button = (text, label, act) => {
      const one = document.createElement("button");
      one.type = "button"; one.textContent = text; one.setAttribute("aria-label", `${label}: ${svg.getAttribute("aria-label")}`); one.addEventListener("click", act); bar.appendChild(one);
    };
    if (panels.some((panel) => !panel.x.fixed && !panel.y.fixed)) {
      button("+", "Zoom in", () => { panels.forEach((panel) => panel.x.factor(1.6)); redraw(); });
      button("−", "Zoom out", () => { panels.forEach((panel) => { panel.x.factor(1 / 1.6); panel.y.factor(1 / 1.6); }); redraw(); });
      button("all", "Show all", reset);
    } else note.textContent = "";
    button("save", "Save as SVG", save);
    bar.appendChild(note); (svg.closest(".scroll") || svg).after(bar);
    const place = (event) => { const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse()); return [at.x, at.y]; };
    let start = null;
    svg.addEventListener("pointerdown", (event) => {
      const at = place(event), panel = panels.find((one) => one.holds(at));
      if (event.pointerType === "mouse" && event.button === 0 && panel && !(panel.x.fixed || panel.y.fixed)) { start = { at, panel }; svg.setPointerCapture(event.pointerId); event.preventDefault(); }
    });
    svg.addEventListener("pointermove", (event) => {
      const at = place(event), panel = start ? start.panel : panels.find((one) => one.holds(at)), spot = panel && panel.nearest(at);
      dot.setAttribute("visibility", spot ? "visible" : "hidden");
      if (spot) {
        dot.setAttribute("cx", spot.x); dot.setAttribute("cy", spot.y);
        const parts = [[panel.x, spot.x], [panel.y, spot.y]].filter(([axis]) => !axis.fixed).map(([axis, value]) => `${axis.label || "value"}: ${number(axis.value(value))}`);
        note.textContent = [spot.label, ...parts].filter(Boolean).join(" · ");
      }
      if (start) {
        const [x, y] = start.at;
        for (const [key, value] of Object.entries({ x: Math.min(x, at[0]), y: Math.min(y, at[1]), width: Math.abs(x - at[0]), height: Math.abs(y - at[1]), visibility: "visible" })) frame.setAttribute(key, value);
      }
    });
    svg.addEventListener("pointerup", (event) => {
      if (!start) return;
      const at = place(event), { at: from, panel } = start;
      start = null; frame.setAttribute("visibility", "hidden");
      if (Math.abs(at[0] - from[0]) > 6) alike(panel).forEach((one) => one.x.show(from[0], at[0]));
      if (Math.abs(at[1] - from[1]) > 12) panel.y.show(from[1], at[1]);
      redraw();
    });
    svg.addEventListener("dblclick", reset);
  };
  for (const svg of document.querySelectorAll("figure svg[data-axes]")) view(svg);
})();
