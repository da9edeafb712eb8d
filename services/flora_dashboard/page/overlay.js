// Stem, target and obstacle over the photograph, in its own pixels.
import { pathOf, shape } from "./svg.js";

// Obstacle and target, where `place` puts a point in cm, at so many px per cm.
export function drawTask(svg, { target, obstacle }, place, scale) {
  if (obstacle) {
    const [x, y] = place([obstacle.x_cm - obstacle.width_cm / 2, obstacle.y_cm + obstacle.height_cm / 2]);
    svg.append(shape("rect", { class: "obstacle", x, y, width: obstacle.width_cm * scale, height: obstacle.height_cm * scale }));
  }
  if (target) {
    const [cx, cy] = place([target.x_cm, target.y_cm]);
    svg.append(shape("circle", { class: "target", cx, cy, r: target.radius_cm * scale }));
  }
}

export function drawOverlay(svg, view, isWanted) {
  svg.replaceChildren();
  const camera = view.camera;
  if (!camera || !isWanted) return;
  svg.setAttribute("viewBox", `0 0 ${camera.width_px} ${camera.height_px}`);
  const scale = camera.px_per_cm;
  const place = ([x, y]) => [camera.anchor_px[0] + x * scale, camera.anchor_px[1] - y * scale];
  drawTask(svg, view, place, scale);
  const stem = view.last.stem?.message;
  if (!stem || !stem.points_cm.length) return;
  const points = stem.points_cm.map(place);
  const when = view.is_measured ? "" : " before";
  svg.append(shape("path", { class: "stem under", d: pathOf(points) }), shape("path", { class: `stem${when}`, d: pathOf(points) }));
  const [cx, cy] = points.at(-1);
  // Two standard deviations of the tip.
  if (stem.uncertainty_mm.length) svg.append(shape("circle", { class: "doubt", cx, cy, r: 0.2 * stem.uncertainty_mm.at(-1) * scale }));
  svg.append(shape("circle", { class: "tip", cx, cy, r: 6 }));
}
