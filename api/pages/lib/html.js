/** Preact with htm: components as functions, markup as template literals, no build step. */

import htm from "../vendor/htm.js";
import { h, render } from "../vendor/preact.js";

export { useCallback, useEffect, useId, useLayoutEffect, useMemo, useRef, useState } from "../vendor/preact-hooks.js";
export { render };
export const html = htm.bind(h);
