// Bundles the explorer into ../static: one script (three.js inside) and one style sheet, nothing loaded from elsewhere.
import { build } from "esbuild";
import { copyFileSync, readFileSync, writeFileSync } from "node:fs";

const out = "../static";
await build({
  entryPoints: ["src/main.js"],
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  legalComments: "none",
  banner: { js: "/* qdil explorer, MIT; contains three.js, MIT (see THREE-LICENSE) */" },
  outfile: `${out}/explorer.js`,
});
copyFileSync("src/explorer.css", `${out}/explorer.css`);
writeFileSync(`${out}/THREE-LICENSE`, readFileSync("node_modules/three/LICENSE"));
