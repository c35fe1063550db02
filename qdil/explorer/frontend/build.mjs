// Bundles the explorer into ../static: one script (three.js inside) and one style sheet, nothing loaded from elsewhere.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { copyFileSync, readdirSync, readFileSync, writeFileSync } from "node:fs";

const out = "../static";

// Of everything that the script is made from; a test computes it anew, so that a script older than its sources is noticed.
function sources() {
  const hash = createHash("sha256");
  const scripts = readdirSync("src").filter((name) => name.endsWith(".js")).sort().map((name) => `src/${name}`);
  for (const path of ["build.mjs", "package-lock.json", ...scripts]) hash.update(`${path}\n`).update(readFileSync(path));
  return hash.digest("hex");
}

const banner = "qdil explorer, MIT; contains three.js, MIT (see THREE-LICENSE)";
await build({
  entryPoints: ["src/main.js"],
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  legalComments: "none",
  banner: { js: `/* ${banner}; sources sha256:${sources()} */` },
  outfile: `${out}/explorer.js`,
});
copyFileSync("src/explorer.css", `${out}/explorer.css`);
writeFileSync(`${out}/THREE-LICENSE`, readFileSync("node_modules/three/LICENSE"));
