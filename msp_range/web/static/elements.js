// What all parts of the page use to write into it.

export const byId = (id) => document.getElementById(id);
export const metres = (value) => `${rounded(value, 2)} m`;

// A number with its digits; no '-0.0'.
export const rounded = (value, digits) => (Math.round(value * 10 ** digits) / 10 ** digits + 0).toFixed(digits);

export function made(tag, text, className = "") {
  const element = document.createElement(tag);
  element.textContent = text;
  element.className = className;
  return element;
}
