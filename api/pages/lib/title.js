/** The tab's title: what is seen, and of a job or a sweep how it goes. */

import { useEffect } from "./html.js";

/** @param {(string | null | undefined)[]} parts Those that are empty are left out. */
export const useTitle = (...parts) => {
  const title = [...parts.filter(Boolean), "Gaitway"].join(" · ");
  useEffect(() => (document.title = title) && undefined, [title]);
};
