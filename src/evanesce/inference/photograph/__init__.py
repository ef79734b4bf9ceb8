"""The photograph of a printed board as data, nominal prediction and forms for the core of :mod:`evanesce.inference`."""
