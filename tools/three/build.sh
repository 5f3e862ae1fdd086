#!/usr/bin/env bash
# Make baselines/pictures/page/three.min.js and its licence again, from npm: three.js and esbuild in the versions of
# package.json. The same versions give the same bytes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
page=../../baselines/pictures/page

npm install --no-audit --no-fund --no-package-lock --silent
version=$(node -p "JSON.parse(require('fs').readFileSync('node_modules/three/package.json')).version")
npx esbuild entry.js --bundle --minify --format=iife --global-name=THREE --target=es2020 --legal-comments=none \
  --banner:js="/* three.js $version, MIT licence: three.LICENSE */" --outfile="$page/three.min.js"
cp node_modules/three/LICENSE "$page/three.LICENSE"
rm -rf node_modules
