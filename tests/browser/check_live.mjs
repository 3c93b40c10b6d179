// Opens the page of a run that goes on in headless Chromium, uses it, and prints what it finds as JSON.
//
//   node check_live.mjs URL [SCREENSHOT_PREFIX]
//
// Exit code 3: there is no browser, see browser.mjs. The run must go on until it is stopped here.
import { browser } from './browser.mjs';

const [url, screenshots] = process.argv.slice(2);
const chromium = await browser();
const seen = { console: [], errors: [], requests: [], views: {} };
const deadline = 60000;
const pause = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));
try {
    const page = await chromium.newPage({ viewport: { width: 390, height: 844 }, colorScheme: 'light' });
    page.on('console', (message) => seen.console.push(`${message.type()}: ${message.text()}`));
    page.on('pageerror', (error) => seen.errors.push(error.message));
    page.on('request', (request) => {
        if (!request.url().startsWith('data:')) seen.requests.push(request.url());
    });
    await page.goto(url, { waitUntil: 'load' });
    const frame = () => page.evaluate(() => now?.frame ?? 0);
    const state = (text) => page.waitForFunction((text) => document.getElementById('phase').textContent === text, text, { timeout: deadline });
    // A policy is there, and was looked at.
    await page.waitForFunction(() => maps !== null && curves?.success.length > 0 && now.features.series.length > 0, null, { timeout: deadline });
    const first = await frame();
    await page.waitForFunction((first) => now.frame > first, first, { timeout: deadline });
    seen.moves = { first, later: await frame() };

    // How many different colours each drawing has, what is broken, and what is wider than the window.
    const view = async (name, width, scheme) => {
        await page.setViewportSize({ width, height: 844 });
        await page.emulateMedia({ colorScheme: scheme });
        await page.evaluate(() => draw());
        seen.views[name] = await page.evaluate(async () => {
            const colours = {};
            for (const canvas of document.querySelectorAll('canvas')) {
                // A copy: to read from a canvas changes how the browser draws it, and it says so.
                const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', { willReadFrequently: true });
                copy.drawImage(canvas, 0, 0);
                const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
                const found = new Set();
                for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 0) found.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]);
                colours[canvas.id] = found.size;
            }
            const images = {};
            for (const image of document.images) {
                await image.decode().catch(() => {});
                images[image.id] = [image.naturalWidth, image.naturalHeight];
            }
            const root = document.documentElement;
            return {
                colours, images,
                overflow: root.scrollWidth - root.clientWidth,
                paper: getComputedStyle(document.body).backgroundColor,
                where: document.getElementById('where').textContent,
                smallest: Math.min(...[...document.querySelectorAll('button:not([hidden])')].map((b) => b.getBoundingClientRect().height)),
            };
        });
        if (screenshots) await page.screenshot({ path: `${screenshots}-${name}.png`, fullPage: true });
    };
    await view('phone', 390, 'light');
    await view('phone_dark', 390, 'dark');
    await view('desk', 1280, 'light');

    // A pause holds: what was under way is written, then nothing moves.
    await page.click('#pause');
    await state('paused');
    await pause(2500);
    const held = await frame();
    await pause(2500);
    seen.pause = { held, still: await frame() };
    if (screenshots) await page.screenshot({ path: `${screenshots}-paused.png` });

    // A goal is moved by a click on the map, while the run stands still.
    const place = { x: 0.8, y: 1.0 };
    await page.click('#move');
    await page.evaluate(() => $('map').scrollIntoView({ block: 'center' }));
    const [left, top] = await page.evaluate(({ x, y }) => {
        const box = $('map').getBoundingClientRect();
        const [px, py] = view(box.width, box.height).to([x, y]);
        return [box.left + px, box.top + py];
    }, place);
    await page.mouse.click(left, top);
    // The answer, not the hint that stood there before the click.
    await page.waitForFunction(() => !moving && document.getElementById('message').textContent !== '', null, { timeout: deadline });
    seen.goal = { place, message: await page.textContent('#message'), waiting: await page.evaluate(async () => (await call('/now')).moves) };

    await page.click('#pause');
    await page.waitForFunction((held) => now.frame > held, held, { timeout: deadline });
    seen.pause.later = await frame();

    // The end is shown: the log is closed.
    await page.click('#stop');
    await page.click('#stop');
    await state('over');
    seen.end = await page.textContent('#message');
    await pause(1500);
} finally {
    await chromium.close();
}
console.log(JSON.stringify(seen));
