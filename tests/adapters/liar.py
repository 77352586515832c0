"""A library that lies."""


def lying(real, tamper):
    """The library's class with ``tamper`` applied to what step number 5 and later return."""

    class Liar:
        def __init__(self, *arguments, **options):
            self.real, self.count = real(*arguments, **options), 0

        def init_step(self, *arguments):
            return self.real.init_step(*arguments)

        def step(self, *arguments, **options):
            self.count += 1
            result = self.real.step(*arguments, **options)
            if self.count >= 5:
                tamper(result)
            return result

    return Liar
