// The calls of the server, out of its own description.

import { get } from "./api.js";
import { $, make } from "./draw.js";

const { paths, components } = await get("openapi.json");
const fieldsOf = (call) => {
  const body = call.requestBody?.content?.["application/json"]?.schema?.$ref?.split("/").at(-1);
  const fields = Object.entries(components.schemas[body]?.properties ?? {}).map(([name, { description }]) => `${name}${description ? `: ${description}` : ""}`);
  return [...(call.parameters ?? []).map(({ name, in: where }) => `${name} (${where})`), ...fields];
};
$("calls").replaceChildren(
  ...Object.entries(paths).flatMap(([path, calls]) =>
    Object.entries(calls).map(([method, call]) =>
      make("article", {}, make("h2", {}, make("code", {}, `${method.toUpperCase()} ${path}`)), make("p", {}, call.summary ?? ""), make("ul", { class: "reasons" }, ...fieldsOf(call).map((field) => make("li", {}, field)))),
    ),
  ),
);
