// Starts headless Chromium, or ends with exit code 3 where there is none (its packages are missing, or it does not start).
//
// ADAGIO_BROWSER names the folder into which `npm install --prefix FOLDER playwright-core @sparticuz/chromium` went;
// ADAGIO_CHROMIUM names another Chromium.
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';
import path from 'node:path';

async function start() {
    const folder = path.resolve(process.env.ADAGIO_BROWSER ?? 'target/browser');
    const require = createRequire(path.join(folder, 'package.json'));
    const load = async (name) => import(pathToFileURL(require.resolve(name)));
    const { chromium } = await load('playwright-core').then((found) => found.default ?? found);
    if (process.env.ADAGIO_CHROMIUM) {
        return chromium.launch({ executablePath: process.env.ADAGIO_CHROMIUM, headless: true, args: ['--no-sandbox'] });
    }
    const packed = (await load('@sparticuz/chromium')).default;
    return chromium.launch({ executablePath: await packed.executablePath(), args: ['--no-sandbox', '--disable-gpu'], headless: true });
}

/** A browser. */
export async function browser() {
    try {
        return await start();
    } catch (error) {
        console.error(`no browser: ${error.message.split('\n')[0]}`);
        process.exit(3);
    }
}
