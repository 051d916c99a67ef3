# cython: language_level=3
"""Twin of a function of `data`."""

from cpython.object cimport PyObject_GenericSetAttr

TWINS = ('changed',)


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
