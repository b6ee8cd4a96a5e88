/** The address of what is seen, the tab's title, and the page of the documentation about it. */

import { useEffect, useState } from "./html.js";

function current() {
  const [path, query = ""] = location.hash.replace(/^#\/?/, "").split("?");
  return { path: path.split("/").filter(Boolean).map(decodeURIComponent), query: new URLSearchParams(query) };
}

/** The route of the present address; the component is drawn again when it changes. */
export function useRoute() {
  const [route, setRoute] = useState(current);
  useEffect(() => {
    const listener = () => setRoute(current());
    addEventListener("hashchange", listener);
    return () => removeEventListener("hashchange", listener);
  }, []);
  return route;
}

/** The address of a route. query: an object or URLSearchParams; empty values are left out, lists repeat. */
export function href(path, query = {}) {
  const said = new URLSearchParams();
  const pairs = query instanceof URLSearchParams ? [...query] : Object.entries(query);
  for (const [name, value] of pairs) for (const one of [value].flat()) if (one || one === 0) said.append(name, one);
  return `#/${path.map(encodeURIComponent).join("/")}${said.size ? `?${said}` : ""}`;
}

export const go = (path, query) => (location.hash = href(path, query));

/** Change parts of the query; with `quietly`, without a new entry in the browser's history. */
export function change(parts, quietly = false) {
  const { path, query } = current();
  for (const [name, value] of Object.entries(parts)) {
    query.delete(name);
    for (const one of [value].flat()) if (one || one === 0) query.append(name, one);
  }
  const address = href(path, query);
  if (!quietly) location.hash = address;
  else if (address !== location.hash) {
    history.replaceState(null, "", address);
    dispatchEvent(new HashChangeEvent("hashchange"));
  }
}

/** @param {(string | null | undefined)[]} parts Those that are empty are left out. */
export const useTitle = (...parts) => {
  const title = [...parts.filter(Boolean), "Gaitway"].join(" · ");
  useEffect(() => (document.title = title) && undefined, [title]);
};

const DOCS = "https://github.com/gaitway/gaitway/blob/main/docs/";
const PAGES = {
  jobs: "training.md",
  compare: "page.md",
  sweeps: "sweeps.md",
  submit: "training.md",
  models: "environments/mjcf.md",
  clips: "imitation.md",
  workers: "operations.md",
  usage: "operations.md",
  news: "teams.md",
  account: "teams.md",
};

/** The page of the documentation about a view. */
export const docsOf = (view) => `${DOCS}${PAGES[view] || "page.md"}`;
