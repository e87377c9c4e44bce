"""Elements of the screen that the pages are made of, and its texts.

view           what a page is given: desk, texts, elements, start of a job
plan_question  what a job would move and write, before it starts
unfinished     interrupted work, to go on with or to discard
zero_switches  what a person says of the axis's zero
pieces, plots, drawings, campaigns  parts of pages
texts          texts in three languages           browsers  one browser, its language and control
"""
