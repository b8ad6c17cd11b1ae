"use strict";
// Zoom and pan: every figure changes its viewBox and nothing else, so that the page is whole without this script.
document.querySelector(".hint").hidden = false;
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

  const zoom = () => home[2] / view[2];
  const show = () => {
    svg.setAttribute("viewBox", view.join(" "));
    svg.style.setProperty("--plot-zoom", zoom());
    svg.classList.toggle("zoomed", zoom() > 1.001);
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
  const reset = () => {
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
  svg.addEventListener("pointermove", (event) => {
    const before = touches.get(event.pointerId);
    if (!before) return;
    const now = point(event.clientX, event.clientY);
    const other = [...touches].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (p) => Math.hypot((p[0] - other[0]) * home[2], (p[1] - other[1]) * home[3]);
      scale(apart(now) / Math.max(apart(before), 1e-6), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    } else if (zoom() > 1.001) {
      move(now[0] - before[0], now[1] - before[1]);
    }
    touches.set(event.pointerId, now);
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
    svg.addEventListener(end, (event) => touches.delete(event.pointerId));
  }
  svg.addEventListener("dblclick", reset);
  svg.addEventListener("keydown", (event) => {
    const act = {
      "+": () => scale(1.4), "=": () => scale(1.4), "-": () => scale(1 / 1.4), "0": reset, Escape: reset,
      ArrowLeft: () => move(0.1, 0), ArrowRight: () => move(-0.1, 0), ArrowUp: () => move(0, 0.1), ArrowDown: () => move(0, -0.1),
    }[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey || (event.key.startsWith("Arrow") && zoom() <= 1.001)) return;
    event.preventDefault();
    act();
  });
});
