# cython: language_level=3
"""Twins of functions of `data`. They write to the memory of records, past the interpreter."""

from dataclasses import MISSING, fields
from types import MemberDescriptorType

from cpython.object cimport PyObject
from cpython.ref cimport Py_INCREF, Py_XDECREF

TWINS = ('changed', 'quickly_filled')

cdef extern from "Python.h":
    """
    #include "structmember.h"
    #define OFFSET(slot) (((PyMemberDescrObject *)(slot))->d_member->offset)
    #define FIELD(record, offset) ((PyObject **)((char *)(record) + (offset)))
    """
    Py_ssize_t OFFSET(object slot)
    PyObject** FIELD(object record, Py_ssize_t offset)

cdef enum:
    MOST_FIELDS = 40


cdef class Layout:
    """Where a frozen dataclass with slots keeps its fields, and what they are where nothing is given."""

    cdef tuple names
    cdef dict places, defaults, factories
    cdef Py_ssize_t count
    cdef Py_ssize_t[MOST_FIELDS] offsets

    def __cinit__(self, cls):
        items = fields(cls)
        self.names = tuple([item.name for item in items])
        self.places = {name: i for i, name in enumerate(self.names)}
        self.defaults = {item.name: item.default for item in items if item.default is not MISSING}
        self.factories = {
            item.name: item.default_factory for item in items if item.default_factory is not MISSING
        }
        self.count = len(items)
        if self.count > MOST_FIELDS:
            raise TypeError(f'{cls.__name__} has more than {MOST_FIELDS} fields')
        for i, name in enumerate(self.names):
            slot = getattr(cls, name, None)
            if type(slot) is not MemberDescriptorType:
                raise TypeError(f'{cls.__name__} has no slot for {name}')
            self.offsets[i] = OFFSET(slot)


cdef dict LAYOUTS = {}


cdef Layout layout_of(cls):
    layout = LAYOUTS.get(cls)
    if layout is None:
        layout = LAYOUTS[cls] = Layout(cls)
    return <Layout>layout


cdef inline void put(object record, Py_ssize_t offset, object value):
    """Write a field."""
    cdef PyObject* before = FIELD(record, offset)[0]
    Py_INCREF(value)
    FIELD(record, offset)[0] = <PyObject*>value
    Py_XDECREF(before)


def quickly_filled(cls):
    cdef Layout layout = Layout(cls)
    LAYOUTS[cls] = layout

    def __init__(self, *args, **values):
        cdef Py_ssize_t given = len(args), i
        if given > layout.count:
            raise TypeError(f'{cls.__name__} has {layout.count} fields, not {given}')
        for i in range(given):
            put(self, layout.offsets[i], args[i])
        for name, value in values.items():
            place = layout.places.get(name)
            if place is None or place < given:
                raise TypeError(f'{cls.__name__} got a field twice, or one that it has not: {name}')
            put(self, layout.offsets[place], value)
        for i in range(given, layout.count):
            if FIELD(self, layout.offsets[i])[0] != NULL:
                continue
            name = layout.names[i]
            if name in layout.defaults:
                put(self, layout.offsets[i], layout.defaults[name])
            elif name in layout.factories:
                put(self, layout.offsets[i], layout.factories[name]())
            else:
                raise TypeError(f'{cls.__name__} lacks its field {name}')

    cls.__init__ = __init__
    return cls


def changed(item, /, **values):
    cls = type(item)
    cdef Layout layout = layout_of(cls)
    copy = cls.__new__(cls)
    cdef Py_ssize_t i
    for i in range(layout.count):
        put(copy, layout.offsets[i], <object>FIELD(item, layout.offsets[i])[0])
    for name, value in values.items():
        place = layout.places.get(name)
        if place is None:
            raise TypeError(f'{cls.__name__} has no field {name}')
        put(copy, layout.offsets[place], value)
    return copy
