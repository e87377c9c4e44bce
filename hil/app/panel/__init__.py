"""The operator's screen: pages in a browser that show the state of `hil.desk` and call it. They contain no logic.

server         addresses, interrupted work   guard      access
frame          what is around every page: stop, lost data, alarm, a running job's question
bar            status bar, rail of pages     events     events and alarm
elsewhere      answers beside the pages      pages      the list of pages

How a page is added

1. What it starts goes to `hil/<room>/job.py`: functions of a connected axis that the command line's verb calls too, a plan (`Plan`:
   what moves how far, what is written), and a `Job` made of both. A job runs in the axis's thread and gets a `Workplace`:
   `place.drive`, `place.session`, `place.machine()`, `place.opened_store()`, `place.listener` for events, `place.tell` for messages,
   `place.ask` for questions to the operator (a line in `[ask]`; they are shown on every page).
   A plan that is `locked` needs the builder's role. `reached` says of a result whether it is what the job was for: one that is not is
   shown as ended without a result.
2. Contents that are more than one figure of the desk go to `hil/<room>/page_data.py`: a function of the desk that returns a frozen
   value (`backlash_screen`), tested without a browser.
3. `hil/<room>/page.py` has `draw(view: View) -> None`. It puts elements on the screen and calls `view.every(refresh)`. It makes
   figures with `view.value(key, unit)`, buttons with `view.button(key, action)`, frames with `with view.card(key)`, names any other
   element with `view.named(element, name)`, and starts a job with `await view.ask_and_run(job)`, which asks first. A button that
   cannot be pressed says why: `button.allow(why_not)`. A card with live figures names their source (`live="drive"`), so that the
   page's script marks it once that source is silent. Start, progress, verdict and the plot that matters stand in a `hil-job-page`,
   within 1366 × 768; instructions and what is rarely needed are folded (`view.how`, `view.fold`). What is written is asked with its
   old and new value: `changes=[view.change(name, old, new, unit)]`.
4. The page is listed in `hil/app/panel/pages/__init__.py`.
5. Its texts go to `en.toml`, `de.toml` and `zh.toml` in `hil/ui/screen/texts`, the same keys in each: `[<page>]` for its own, and a
   line in `[page]` (title), `[job]` (kind of the job, blanks as _), `[plan.move]` and `[plan.write]` (what the plan moves and writes),
   `[said]` (patterns of its procedures' messages).

An element's name (`data-name`) is by default its text's key; tests find elements by it. A refresh is called five times a second and
sends only what has changed: it reads the desk and sets texts, and never waits. Work of more than a few milliseconds that is no job
goes through `await view.in_worker_thread(work)`.
"""
