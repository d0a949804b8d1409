// The performance profile of the backends that are ticked, drawn again at every choice.
const BINS = 240, FARTHEST = 1000;  // of the factor, evenly in its logarithm
const WIDE = 720, HIGH = 320, LEFT = 44, FOOT = 34;
const FACTORS = [1, 2, 5, 10, 100];
const SVG = new DOMParser().parseFromString("<svg></svg>", "text/html").querySelector("svg").namespaceURI;

// For each backend its counts of QPs by factor: the share within any factor is a sum of them.
function shares(times, chosen, qps) {
  const curves = chosen.map(() => new Float64Array(BINS + 1));
  const step = BINS / Math.log(FARTHEST);
  for (let i = 0; i < qps; i++) {
    let best = Infinity;
    for (const s of chosen) if (times[s][i] > 0 && times[s][i] < best) best = times[s][i];
    chosen.forEach((s, at) => {
      if (!times[s][i]) return;
      const bin = Math.ceil(Math.log(times[s][i] / best) * step);
      if (bin <= BINS) curves[at][bin] += 1 / qps;
    });
  }
  for (const curve of curves) for (let b = 1; b <= BINS; b++) curve[b] += curve[b - 1];
  return curves;
}

const within = (curve, factor) => curve[Math.floor((Math.log(factor) / Math.log(FARTHEST)) * BINS)];
const across = (bin) => LEFT + (bin / BINS) * (WIDE - LEFT - 8);
const up = (share) => 8 + (1 - share) * (HIGH - FOOT - 8);
const hue = (s, count) => `hsl(${Math.round((360 * s) / count)} 65% 48%)`;

function draw(name, attributes, parent, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}

function drawAxes(svg) {
  for (const share of [0, 0.25, 0.5, 0.75, 1]) {
    draw("path", { class: "grid", d: `M${LEFT} ${up(share)}H${WIDE - 8}` }, svg);
    draw("text", { x: LEFT - 6, y: up(share) + 4, "text-anchor": "end" }, svg, `${100 * share} %`);
  }
  for (const factor of [1, 2, 5, 10, 50, 100, 1000]) {
    const x = across((Math.log(factor) / Math.log(FARTHEST)) * BINS);
    draw("text", { x, y: HIGH - FOOT + 18, "text-anchor": factor === FARTHEST ? "end" : "middle" }, svg, `${factor}×`);
  }
}

function drawCurves(svg, curves, chosen, count) {
  curves.forEach((curve, at) => {
    const points = [...curve].map((share, bin) => `${across(bin).toFixed(1)},${up(share).toFixed(1)}`);
    const dash = ["", "6 3", "2 2"][chosen[at] % 3];
    draw("polyline", { points: points.join(" "), stroke: hue(chosen[at], count), "stroke-dasharray": dash }, svg);
  });
}

// Name the curve that is nearest to the pointer.
function tell(event, svg, said, curves, names) {
  const box = svg.getBoundingClientRect();
  const x = ((event.clientX - box.left) / box.width) * WIDE, y = ((event.clientY - box.top) / box.height) * HIGH;
  const bin = Math.min(BINS, Math.max(0, Math.round(((x - LEFT) / (WIDE - LEFT - 8)) * BINS)));
  const away = curves.map((curve) => Math.abs(up(curve[bin]) - y));
  const at = away.indexOf(Math.min(...away));
  if (at < 0) return;
  const factor = Math.exp((bin / BINS) * Math.log(FARTHEST));
  said.textContent = `${names[at]}: verified and within ${factor.toPrecision(2)}× of the fastest on ${(100 * curves[at][bin]).toFixed(1)} % of the QPs`;
  [...svg.querySelectorAll("polyline")].forEach((line, i) => line.classList.toggle("near", i === at));
}

function rank(list, curves, names, factor) {
  const order = names.map((name, at) => [within(curves[at], factor), name]);
  order.sort((one, other) => other[0] - one[0] || one[1].localeCompare(other[1]));
  list.replaceChildren();
  for (const [share, name] of order) element("li", `${name}: ${(100 * share).toFixed(1)} %`, list);
}

function choices(box, data, changed) {
  return data.solvers.map((name, s) => {
    const label = element("label", null, box), tick = element("input", null, label);
    tick.type = "checkbox";
    tick.checked = true;
    tick.addEventListener("change", changed);
    label.append(name);
    label.style.setProperty("--hue", hue(s, data.solvers.length));
    return tick;
  });
}

function makeProfile(box) {
  const data = JSON.parse(document.getElementById("times").textContent);
  const ticks = choices(element("div", null, box), data, () => redraw());
  const svg = draw("svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, role: "img", "aria-label": "performance profile" }, box);
  const said = element("p", "Point at a curve.", box), label = element("label", "Ranked by the share within a factor of ", box);
  const factor = element("select", null, label), list = element("ol", null, box);
  for (const each of FACTORS) element("option", each, factor);
  factor.value = "2";
  let curves = [], names = [];
  const order = () => rank(list, curves, names, Number(factor.value));
  function redraw() {
    const chosen = ticks.flatMap((tick, s) => (tick.checked ? [s] : []));
    names = chosen.map((s) => data.solvers[s]);
    curves = shares(data.times, chosen, data.qps);
    svg.replaceChildren();
    drawAxes(svg);
    drawCurves(svg, curves, chosen, data.solvers.length);
    order();
  }
  factor.addEventListener("change", order);
  svg.addEventListener("pointermove", (event) => tell(event, svg, said, curves, names));
  redraw();
}

// It is made when it is first seen; until then, and without a script, the drawn figure stands there.
const place = document.getElementById("profile");
if (place) {
  new IntersectionObserver((seen, observer) => {
    if (!seen.some((each) => each.isIntersecting)) return;
    observer.disconnect();
    document.getElementById("drawn_profile").hidden = true;
    makeProfile(place);
  }).observe(place);
}
