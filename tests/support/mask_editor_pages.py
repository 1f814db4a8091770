"""The page of `vgmpi photo --edit` as a process of its own, and a browser's hand on it."""

from tests.support.page_process import PageProcess


class EditorProcess(PageProcess):
    """`vgmpi photo PHOTO [LAYOUT] --edit -o OUT` as a process."""

    def __init__(self, *words):
        super().__init__("photo", *words, "--edit")


class Hand:
    """Mouse and keys on the page; positions are pixels of the photograph."""

    def __init__(self, page):
        self.page = page
        page.set_default_timeout(60_000)
        page.evaluate("() => editor.ready")
        self.settle()

    def settle(self):
        """Wait until no mask is being computed."""
        self.page.wait_for_function("() => editor.busy === 0 && editor.pending.size === 0")

    def corner(self):
        area = self.page.locator("#marks").bounding_box()
        return area["x"], area["y"]

    def drag(self, *places, button="left"):
        left, top = self.corner()
        mouse = self.page.mouse
        mouse.move(left + places[0][0] + 0.3, top + places[0][1] + 0.3)
        mouse.down(button=button)
        for x, y in places[1:]:
            mouse.move(left + x + 0.3, top + y + 0.3, steps=8)
        mouse.up(button=button)
        self.settle()

    def press(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)
        self.settle()

    def name(self, number, text, height=""):
        self.page.get_by_label(f"name of object {number}").fill(text)
        self.page.get_by_label(f"height of object {number}").fill(height)
        self.page.keyboard.press("Enter")
        self.settle()

    def objects(self):
        return self.page.evaluate("() => editor.state.objects")

    def message(self):
        return self.page.locator("#message").inner_text()

    def save(self):
        self.press("s")
        self.page.get_by_text("saved").first.wait_for()
