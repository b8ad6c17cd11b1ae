"use strict";
// Zoom and pan: every figure changes its viewBox and nothing else, so that the page is whole without this script.
// Figures over time follow each other; views of space are turned about their middle.
const followers = [];
document.querySelector(".hint").hidden = !document.querySelector("svg.plot");
const unfold = () => {
  const section = document.getElementById(location.hash.slice(1));
  section?.querySelector("details")?.setAttribute("open", "");
};
addEventListener("hashchange", unfold);
unfold();
document.querySelectorAll("nav a").forEach((link) => link.addEventListener("click", () => setTimeout(unfold)));
document.querySelectorAll("svg.plot").forEach((svg) => {
  const home = svg.getAttribute("viewBox").split(" ").map(Number);
  const view = home.slice();
  const touches = new Map();
  svg.tabIndex = 0;

  // What the places of each panel stand for: shares of its box -> numbers of its scales; and what it is called.
  const texts = [...svg.querySelectorAll("text")].map((t) => ({ x: Number(t.getAttribute("x")), y: Number(t.getAttribute("y")), says: t.textContent }));
  const panels = [...svg.querySelectorAll("[data-panel]")].map((g) => {
    const [left, top, width, height, ...ends] = g.dataset.panel.split(" ").map(Number);
    const scale = ([low, high, log, known]) => known && {
      at: (share) => log ? low * (high / low) ** share : low + (high - low) * share,
      share: (value) => log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low),
      step: Math.abs(high - low), log,
    };
    const nearest = (x, y) => texts.filter((t) => Math.abs(t.y - y) < 2).sort((a, b) => Math.abs(a.x - x) - Math.abs(b.x - x))[0];
    return {
      left, top, width, height, x: scale(ends.slice(0, 4)), y: scale(ends.slice(4)),
      title: nearest(left, top - 18), below: nearest(left + width, top + height + 50),
    };
  });
  const text = (value, step) => Math.abs(value) < 1e-9 * step ? "0" : String(Number(value.toPrecision(Math.max(5, Math.ceil(Math.log10(Math.abs(value) / step)) + 3)))).replace("-", "\u2212");
  const readout = document.createElement("p");
  readout.className = "readout";
  svg.after(readout);
  const say = (x, y) => {
    const place = [view[0] + x * view[2], view[1] + y * view[3]];
    const panel = panels.find((p) => place[0] >= p.left && place[0] <= p.left + p.width && place[1] >= p.top && place[1] <= p.top + p.height);
    const u = panel && (place[0] - panel.left) / panel.width, v = panel && (panel.top + panel.height - place[1]) / panel.height;
    const parts = panel ? [["x", panel.x, u], ["y", panel.y, v]].filter(([, scale]) => scale) : [];
    readout.textContent = parts.map(([name, scale, share]) => `${name} ${text(scale.at(share), scale.step)}`).join("   ");
  };
  // A zoomed figure has round ticks of its own along the edges of what is seen, and its names, where they left it.
  const multiples = (low, high, step) => {
    const first = Math.ceil(low / step - 1e-9);
    return Array.from({ length: Math.max(Math.floor(high / step + 1e-9) - first + 1, 0) }, (_, i) => Number(((first + i) * step).toPrecision(12)));
  };
  const roundNumbers = (ends, log, most) => {
    const [low, high] = ends.sort((a, b) => a - b), least = (high - low) / Math.max(most, 1);
    const power = 10 ** Math.floor(Math.log10(least));
    if (!log || high < 10 * low) return multiples(low, high, power * ([1, 2, 5].find((s) => s * power >= least) ?? 10));
    const powers = multiples(Math.floor(Math.log10(low)), Math.log10(high), 1).map((k) => 10 ** k);
    const several = powers.flatMap((p) => [p, 2 * p, 5 * p]).filter((value) => value >= low && value <= high);
    return (several.length > most ? powers.filter((p) => p >= low) : several).map((value) => Number(value.toPrecision(12)));
  };
  const ticks = document.createElementNS(svg.namespaceURI, "g");
  ticks.setAttribute("class", "ticks");
  svg.append(ticks);
  const tick = (label, x, y, anchor = "middle") => {
    const element = document.createElementNS(svg.namespaceURI, "text");
    element.style.textAnchor = anchor;
    element.setAttribute("x", x);
    element.setAttribute("y", y);
    element.textContent = label;
    ticks.append(element);
  };
  const mark = () => {
    ticks.replaceChildren();
    if (zoom() <= 1.001) return;
    for (const p of panels) {
      const x = [Math.max(view[0], p.left), Math.min(view[0] + view[2], p.left + p.width)];
      const y = [Math.max(view[1], p.top), Math.min(view[1] + view[3], p.top + p.height)];
      const one = view[2] / svg.clientWidth, bottom = p.top + p.height;  // figure units a pixel of the screen
      if (x[1] - x[0] < 60 * one || y[1] - y[0] < 40 * one) continue;
      const named = p.title && p.title.y < view[1], below = p.below && p.below.y > view[1] + view[3];
      for (const value of p.x ? roundNumbers(x.map((u) => p.x.at((u - p.left) / p.width)), p.x.log, (x[1] - x[0]) / one / 90) : []) {
        const u = p.left + p.width * p.x.share(value);
        if (u > x[0] + 70 * one && u < x[1] - 15 * one) tick(text(value, p.x.step), u, y[1] - 10 * one);
      }
      for (const value of p.y ? roundNumbers(y.map((v) => p.y.at((bottom - v) / p.height)), p.y.log, (y[1] - y[0]) / one / 45) : []) {
        const v = bottom - p.height * p.y.share(value);
        if (v > y[0] + (named ? 32 : 10) * one && v < y[1] - 10 * one) tick(text(value, p.y.step), x[0] + 6 * one, v, "start");
      }
      if (named) tick(p.title.says, x[0] + 6 * one, y[0] + 14 * one, "start");
      if (below) tick(p.below.says, x[1] - 6 * one, y[1] - 28 * one, "end");
    }
  };

  const zoom = () => home[2] / view[2];
  // Seconds that are seen, where the figure is one over time; the others show the same.
  const timed = svg.querySelector("[data-time]") && panels.find((p) => p.x);
  const moment = (x) => timed.x.at((x - timed.left) / timed.width);
  const follow = (from, to) => {
    const place = (t) => timed.left + timed.width * (t - timed.x.at(0)) / (timed.x.at(1) - timed.x.at(0));
    const width = Math.min(Math.max(place(to) - place(from), home[2] / 40), home[2]), height = width * home[3] / home[2];
    view.splice(0, 4, (place(from) + place(to) - width) / 2, view[1] + (view[3] - height) / 2, width, height);
    inside();
    show(false);
  };
  if (timed) followers.push({ svg, follow });
  const show = (leads = true) => {
    svg.setAttribute("viewBox", view.join(" "));
    svg.style.setProperty("--plot-zoom", zoom());
    svg.classList.toggle("zoomed", zoom() > 1.001);
    mark();
    if (!leads || !timed) return;
    const seen = [moment(view[0]), moment(view[0] + view[2])];
    for (const other of followers) if (other.svg !== svg) other.follow(...seen);
  };
  const inside = () => {
    for (const i of [0, 1]) view[i] = Math.min(Math.max(view[i], home[i]), home[i] + home[i + 2] - view[i + 2]);
  };
  const point = (x, y) => {
    const box = svg.getBoundingClientRect();
    return [(x - box.left) / box.width, (y - box.top) / box.height];
  };
  const scale = (factor, x = 0.5, y = 0.5) => {
    const wanted = Math.min(Math.max(zoom() * factor, 1), 40);
    const width = home[2] / wanted, height = home[3] / wanted;
    view[0] += (view[2] - width) * x;
    view[1] += (view[3] - height) * y;
    view[2] = width;
    view[3] = height;
    inside();
    show();
  };
  const move = (dx, dy) => {
    view[0] -= dx * view[2];
    view[1] -= dy * view[3];
    inside();
    show();
  };
  // A view of space: each point keeps its depth, and is turned about the two axes of the page.
  const space = svg.querySelector("[data-space]");
  const turned = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  let turn = null;
  if (space) {
    const [left, top] = space.dataset.space.split(" ").map(Number);
    const pair = /(-?[\d.e+-]+) (-?[\d.e+-]+)/g;
    const paths = [...space.querySelectorAll("[data-depth]")].map((path) => {
      const d = path.getAttribute("d"), depth = path.dataset.depth.split(" ").map(Number);
      return { path, d, points: [...d.matchAll(pair)].map((m, i) => [m[1] - left, m[2] - top, depth[i]]) };
    });
    const names = [...space.querySelectorAll("[data-place]")].map((g) => {
      const [x, y, depth] = g.dataset.place.split(" ").map(Number);
      return { g, point: [x - left, y - top, depth] };
    });
    const at = (point) => [0, 1].map((i) => turned[i][0] * point[0] + turned[i][1] * point[1] + turned[i][2] * point[2]);
    const rotate = (i, k, angle) => {
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      for (let j = 0; j < 3; j++) [turned[i][j], turned[k][j]] = [c * turned[i][j] + s * turned[k][j], c * turned[k][j] - s * turned[i][j]];
    };
    turn = (right, down) => {
      rotate(0, 2, right);
      rotate(1, 2, down);
      for (const { path, d, points } of paths) {
        let i = 0;
        path.setAttribute("d", d.replace(pair, () => at(points[i++]).map((v, k) => (v + (k ? top : left)).toFixed(2)).join(" ")));
      }
      for (const { g, point } of names) {
        const [x, y] = at(point);
        g.setAttribute("transform", `translate(${(x - point[0]).toFixed(2)} ${(y - point[1]).toFixed(2)})`);
      }
    };
    svg.classList.add("turns");
  }
  const reset = () => {
    turned.forEach((row, i) => row.forEach((_, j) => { row[j] = Number(i === j); }));
    turn?.(0, 0);
    view.splice(0, 4, ...home);
    show();
  };

  svg.addEventListener("wheel", (event) => {
    // The wheel scrolls the page until a figure was clicked, or while Ctrl is held (a pinch on a touch pad).
    if (!event.ctrlKey && document.activeElement !== svg) return;
    event.preventDefault();
    scale(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : event.ctrlKey ? 0.01 : 0.002)), ...point(event.clientX, event.clientY));
  }, { passive: false });
  svg.addEventListener("pointerdown", (event) => {
    touches.set(event.pointerId, point(event.clientX, event.clientY));
    if (event.pointerType === "mouse" || touches.size > 1) svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointerleave", () => { readout.textContent = ""; });
  svg.addEventListener("pointermove", (event) => {
    say(...point(event.clientX, event.clientY));
    const before = touches.get(event.pointerId);
    if (!before) return;
    const now = point(event.clientX, event.clientY);
    const other = [...touches].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (p) => Math.hypot((p[0] - other[0]) * home[2], (p[1] - other[1]) * home[3]);
      scale(apart(now) / Math.max(apart(before), 1e-6), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    } else if (zoom() > 1.001) {
      move(now[0] - before[0], now[1] - before[1]);
    } else {
      turn?.(4 * (now[0] - before[0]), 4 * (now[1] - before[1]) * home[3] / home[2]);
    }
    touches.set(event.pointerId, now);
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
    svg.addEventListener(end, (event) => touches.delete(event.pointerId));
  }
  svg.addEventListener("dblclick", reset);
  const steer = (x, y) => zoom() > 1.001 ? move(x, y) : turn?.(x, y);
  svg.addEventListener("keydown", (event) => {
    const act = {
      "+": () => scale(1.4), "=": () => scale(1.4), "-": () => scale(1 / 1.4), "0": reset, Escape: reset,
      ArrowLeft: () => steer(0.1, 0), ArrowRight: () => steer(-0.1, 0), ArrowUp: () => steer(0, 0.1), ArrowDown: () => steer(0, -0.1),
    }[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey || (event.key.startsWith("Arrow") && zoom() <= 1.001 && !turn)) return;
    event.preventDefault();
    act();
  });
});
