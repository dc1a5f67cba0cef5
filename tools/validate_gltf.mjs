// The errors that the Khronos validator finds in each file, a JSON list a line.
//   npm install --no-save gltf-validator && node tools/validate_gltf.mjs FILE...
// Exit code 3: the package is not installed.
import fs from "node:fs";
import path from "node:path";

let validator;
try {
  validator = (await import("gltf-validator")).default;
} catch {
  process.exit(3);
}
for (const file of process.argv.slice(2)) {
  const beside = (uri) => new Uint8Array(fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri))));
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {
    uri: file,
    maxIssues: 0,
    externalResourceFunction: async (uri) => beside(uri),
  });
  const errors = report.issues.messages.filter((issue) => issue.severity === 0);
  console.log(JSON.stringify(errors.map((issue) => `${issue.code} ${issue.pointer ?? ""}: ${issue.message}`)));
}
