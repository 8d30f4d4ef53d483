// Faults of a page that a reader sees: text that is cut off or overlaps other text, overlapping boxes.
// Returns [{kind, what, where}]; sizes in CSS pixels. SVG text counts like any other.
const SLACK = 1.5;          // rounding of layouts
const LEAST_OVERLAP = 0.12; // of the smaller text: letters have air about them
const width = document.documentElement.clientWidth;
const faults = [];
const shown = (element) => {
  for (let at = element; at && at.nodeType === 1; at = at.parentElement) {
    const style = getComputedStyle(at);
    if (style.display === "none" || style.visibility === "hidden" || style.opacity === "0") return false;
  }
  return true;
};
const textOf = (text) => text.trim().replace(/\s+/g, " ").slice(0, 60);
const place = (box) => `${Math.round(box.left)},${Math.round(box.top + scrollY)} ${Math.round(box.right - box.left)}x${Math.round(box.bottom - box.top)}`;

// every line of every text
const texts = [];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
for (let node = walker.nextNode(); node; node = walker.nextNode()) {
  const parent = node.parentElement;
  if (!node.data.trim() || ["STYLE", "SCRIPT", "title"].includes(parent.tagName) || !shown(parent)) continue;
  const range = document.createRange();
  range.selectNodeContents(node);
  for (const box of range.getClientRects()) {
    if (box.width > 0.5 && box.height > 0.5) texts.push({ box, text: textOf(node.data), parent });
  }
}

// cut off: beyond the page, or beyond an ancestor that hides or scrolls what is too wide for it
for (const { box, text, parent } of texts) {
  if (box.left < -SLACK || box.right > width + SLACK) faults.push({ kind: "cut off", what: text, where: place(box) });
  for (let at = parent; at && at !== document.body; at = at.parentElement) {
    const style = getComputedStyle(at);
    if (style.overflowX === "visible" && style.overflowY === "visible") continue;
    const frame = at.getBoundingClientRect();
    const beyond = box.left < frame.left - SLACK || box.right > frame.right + SLACK
      || box.top < frame.top - SLACK || box.bottom > frame.bottom + SLACK;
    if (beyond) faults.push({ kind: "cut off", what: `${text} (by ${at.tagName.toLowerCase()}.${at.className})`, where: place(box) });
  }
}
if (document.documentElement.scrollWidth > width + SLACK) {
  faults.push({ kind: "cut off", what: "the page is wider than the screen", where: `${document.documentElement.scrollWidth} > ${width}` });
}

// drawings and their marks within the page
for (const mark of document.querySelectorAll("svg, svg *")) {
  const box = mark.getBoundingClientRect();
  if (shown(mark) && box.width > 0 && (box.left < -SLACK || box.right > width + SLACK)) {
    faults.push({ kind: "cut off", what: `${mark.tagName} ${mark.getAttribute("class") || ""}`, where: place(box) });
  }
}

// text on text
texts.sort((a, b) => a.box.top - b.box.top);
for (let i = 0; i < texts.length; i++) {
  const one = texts[i];
  for (let k = i + 1; k < texts.length && texts[k].box.top < one.box.bottom; k++) {
    const other = texts[k];
    if (one.parent.contains(other.parent) && one.parent === other.parent) continue;
    const across = Math.min(one.box.right, other.box.right) - Math.max(one.box.left, other.box.left);
    const down = Math.min(one.box.bottom, other.box.bottom) - Math.max(one.box.top, other.box.top);
    if (across <= SLACK || down <= SLACK) continue;
    const least = Math.min(one.box.width * one.box.height, other.box.width * other.box.height);
    if (across * down > LEAST_OVERLAP * least) {
      faults.push({ kind: "overlap", what: `${one.text} | ${other.text}`, where: place(one.box) });
    }
  }
}

// boxes on boxes
const boxes = [...document.querySelectorAll("h1, h2, h3, p, table, figure, section, .card, .key, .sign, header, footer")].filter(shown);
const frames = boxes.map((element) => element.getBoundingClientRect());
for (let i = 0; i < boxes.length; i++) {
  for (let k = i + 1; k < boxes.length; k++) {
    if (boxes[i].contains(boxes[k]) || boxes[k].contains(boxes[i])) continue;
    const across = Math.min(frames[i].right, frames[k].right) - Math.max(frames[i].left, frames[k].left);
    const down = Math.min(frames[i].bottom, frames[k].bottom) - Math.max(frames[i].top, frames[k].top);
    if (across > SLACK && down > SLACK) {
      const name = (element) => `${element.tagName.toLowerCase()} ${textOf(element.textContent).slice(0, 30)}`;
      faults.push({ kind: "overlap", what: `${name(boxes[i])} | ${name(boxes[k])}`, where: place(frames[k]) });
    }
  }
}
return faults;
