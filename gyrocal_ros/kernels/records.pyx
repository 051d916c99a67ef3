# cython: language_level=3
"""Twins of functions of `data`."""

from dataclasses import MISSING, fields

from cpython.object cimport PyObject_GenericSetAttr

TWINS = ('changed', 'quickly_filled')


def quickly_filled(cls):
    items = fields(cls)
    cdef tuple names = tuple([item.name for item in items])
    cdef dict defaults = {item.name: item.default for item in items if item.default is not MISSING}
    cdef dict factories = {item.name: item.default_factory for item in items if item.default_factory is not MISSING}

    def __init__(self, *args, **values):
        cdef Py_ssize_t given = len(args), used = 0, i
        if given > len(names):
            raise TypeError(f'{cls.__name__} has {len(names)} fields, not {given}')
        for i in range(given):
            PyObject_GenericSetAttr(self, names[i], args[i])
        for i in range(given, len(names)):
            name = names[i]
            if name in values:
                PyObject_GenericSetAttr(self, name, values[name])
                used += 1
            elif name in defaults:
                PyObject_GenericSetAttr(self, name, defaults[name])
            elif name in factories:
                PyObject_GenericSetAttr(self, name, factories[name]())
            else:
                raise TypeError(f'{cls.__name__} lacks its field {name}')
        if used != len(values):
            raise TypeError(f'{cls.__name__} got a field twice, or one that it has not: {", ".join(values)}')

    cls.__init__ = __init__
    return cls


def changed(item, /, **values):
    cls = type(item)
    copy = cls.__new__(cls)
    cdef Py_ssize_t found = 0
    for name in cls.__slots__:
        if name in values:
            PyObject_GenericSetAttr(copy, name, values[name])
            found += 1
        else:
            PyObject_GenericSetAttr(copy, name, getattr(item, name))
    if found != len(values):
        raise TypeError(f'{cls.__name__} has no field of one of these names: {", ".join(values)}')
    return copy
