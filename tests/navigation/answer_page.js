// Answers a page of comparisons in Node, with a document that only records: node answer_page.js PAGE KEYS...
"use strict";
const fs = require("fs"), [page, ...keys] = process.argv.slice(2), html = fs.readFileSync(page, "utf8");
const elements = {content: {textContent: html.match(/id="content">(.*?)<\/script>/s)[1]}}, listeners = {}, frames = [];
let drawn = 0, saved;
const pen = new Proxy({}, {
  get: () => (...numbers) => {
    if (numbers.some((n) => typeof n === "number" && !Number.isFinite(n))) throw new Error("drawn where nothing is");
    drawn += 1;
  },
  set: () => true,
});
Object.assign(globalThis, {
  document: {
    getElementById: (id) => elements[id] ?? (elements[id] = {}),
    querySelectorAll: () => [0, 1].map(() => ({getContext: () => pen})),
    createElement: () => ({click: () => {}}),
  },
  performance: {now: () => 0},
  requestAnimationFrame: (frame) => frames.push(frame),
  addEventListener: (kind, listener) => { listeners[kind] = listener; },
  Blob: class { constructor(parts) { saved = parts.join(""); } },
});
URL.createObjectURL = () => "";
(0, eval)(html.match(/<script>(.*?)<\/script>/s)[1]);
for (const [i, key] of keys.entries()) {
  frames.shift()(1000 * i);
  listeners.keydown({key, preventDefault: () => {}});
}
let unsaved = false;
listeners.beforeunload({preventDefault: () => { unsaved = true; }});
elements.save.onclick();
console.log(JSON.stringify({saved, drawn, unsaved, count: elements.count.textContent}));
