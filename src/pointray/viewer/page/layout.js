/** The part of the view that the panel and the legend do not cover. */

const LEAST = 1 / 3; // fraction of the view that must stay free; larger boxes, as on a phone, are ignored

const area = ({ left, top, right, bottom }) => Math.max(0, right - left) * Math.max(0, bottom - top);

/** Return the largest rectangle beside, above or below a box. */
function beside(free, box) {
  if (box.right <= free.left || box.left >= free.right || box.bottom <= free.top || box.top >= free.bottom) return free;
  const parts = [
    { ...free, right: box.left },
    { ...free, left: box.right },
    { ...free, top: box.bottom },
    { ...free, bottom: box.top },
  ];
  return parts.reduce((best, part) => (area(part) > area(best) ? part : best));
}

/**
 * Return the part of a view that boxes leave free.
 *
 * @param {{width: number, height: number}} view  CSS px
 * @param {{left: number, top: number, right: number, bottom: number}[]} boxes  most important first
 * @returns {number[]} left, top, right, bottom, CSS px
 */
export function freeOf({ width, height }, boxes) {
  let free = { left: 0, top: 0, right: width, bottom: height };
  for (const box of boxes) {
    const part = beside(free, box);
    if (area(part) >= LEAST * width * height) free = part;
  }
  return [free.left, free.top, free.right, free.bottom];
}
