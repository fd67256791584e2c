// What all parts of the page use to write into it.

export const byId = (id) => document.getElementById(id);
export const metres = (value) => `${value.toFixed(2)} m`;

export function made(tag, text, className = "") {
  const element = document.createElement(tag);
  element.textContent = text;
  element.className = className;
  return element;
}
