// Opens a report in headless Chromium and prints what it finds as JSON.
//
//   node check_report.mjs REPORT.html [SCREENSHOT_PREFIX]
//
// Exit code 3: there is no browser, see browser.mjs.
import { pathToFileURL } from 'node:url';
import path from 'node:path';
import { browser } from './browser.mjs';

const [page_path, screenshots] = process.argv.slice(2);
const chromium = await browser();
const seen = { console: [], errors: [], requests: [], views: [] };
try {
    for (const [width, scheme] of [[390, 'light'], [390, 'dark'], [800, 'light'], [1280, 'light']]) {
        const page = await chromium.newPage({ viewport: { width, height: 844 }, colorScheme: scheme });
        page.on('console', (message) => seen.console.push(`${message.type()}: ${message.text()}`));
        page.on('pageerror', (error) => seen.errors.push(error.message));
        page.on('request', (request) => {
            if (!request.url().startsWith('data:')) seen.requests.push(request.url());
        });
        await page.goto(pathToFileURL(path.resolve(page_path)).href, { waitUntil: 'load' });
        const view = await page.evaluate(async () => {
            const figures = {};
            for (const figure of document.querySelectorAll('figure')) {
                const svg = figure.querySelector('svg');
                const box = svg.getBoundingClientRect();
                let broken = 0;
                for (const image of svg.querySelectorAll('image')) {
                    const copy = new Image();
                    copy.src = image.getAttribute('href');
                    await copy.decode().catch(() => { broken += 1; });
                }
                // What has no size is not seen.
                const shown = [...svg.querySelectorAll('*')].filter((part) => {
                    const own = part.getBoundingClientRect();
                    return own.width > 0 || own.height > 0;
                });
                figures[figure.id] = { width: box.width, height: box.height, broken, parts: shown.length };
            }
            const root = document.documentElement;
            return {
                figures,
                overflow: root.scrollWidth - root.clientWidth,
                verdict: document.querySelector('.verdict strong').innerText,
                letters: parseFloat(getComputedStyle(document.querySelector('.verdict strong')).fontSize),
                ink: getComputedStyle(document.body).color,
                paper: getComputedStyle(document.body).backgroundColor,
            };
        });
        seen.views.push({ width, scheme, ...view });
        if (screenshots) await page.screenshot({ path: `${screenshots}-${width}-${scheme}.png`, fullPage: true });
        await page.close();
    }
} finally {
    await chromium.close();
}
console.log(JSON.stringify(seen));
