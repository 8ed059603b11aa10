// Elements, without markup in strings: nothing that the rig says is ever taken for HTML.

const SVG = "http://www.w3.org/2000/svg";

export const $ = (id) => document.getElementById(id);

export function element(name, attributes = {}, ...children) {
  return filled(document.createElement(name), attributes, children);
}

export function svg(name, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, name), attributes, children);
}

function filled(node, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

// Text that is set only when it changes, so that nobody's screen reader repeats it every second.
export function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}
