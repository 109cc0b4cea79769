/* Between Python and the kernels: every argument is looked at before a kernel runs.

   The library is linked with no Python: what it needs of one is handed over in a table of functions, all of the stable
   interface of Python 3.11 and later, so that one library serves every version. */

typedef struct object object;
typedef struct { /* Py_buffer */
    void *buf;
    object *obj;
    intptr_t len, itemsize;
    int readonly, ndim;
    char *format;
    intptr_t *shape, *strides, *suboffsets;
    void *internal;
} buffer_view;

typedef struct {
    double (*as_double)(object *);
    object *(*from_double)(double);
    long long (*as_whole)(object *);
    object *(*from_whole)(long long);
    object *(*from_truth)(long);
    int (*is_true)(object *);
    object *(*new_tuple)(intptr_t);
    int (*set_item)(object *, intptr_t, object *);
    object *(*get_item)(object *, intptr_t);
    char *(*bytes_of)(object *);
    int (*get_buffer)(object *, buffer_view *, int);
    void (*release_buffer)(buffer_view *);
    int (*is_contiguous)(const buffer_view *, char);
    object *(*error_occurred)(void);
    object *(*set_error)(object *, const char *, ...);
    void (*set_error_text)(object *, const char *);
    void *(*let_others_run)(void);
    void (*take_back)(void *);
    object *(*call)(object *, ...);
    void (*let_go)(object *);
    object *type_error, *value_error, *contiguous;
} python;

typedef struct { /* PyMethodDef */
    const char *name;
    object *(*function)(object *, object *const *, intptr_t);
    int flags;
    const char *doc;
} definition;

enum { FAST_CALL = 0x80, WITH_FORMAT = 0x4, WITH_STRIDES = 0x10 | 0x8 };
enum { INTS = 0, REALS = 2, BANKS = 4, BUFFER = 7, RECENT = 10, GATE = 13, KIND = 14, SHUT = 1 };

/* Entries of a regressor [count] up to which the plain variant is as fast as that of AVX2 or faster: with two and four
   entries an update of it takes .8 to 1.0 of the time, with eight up to 1.15. */
enum { FEW = 4 };

static python py;

static bool is_small(const StateInts *ints) { return ints->entries <= FEW; }

static bool has_format(const buffer_view *view, char element)
{
    const char *format = view->format ? view->format : "B";
    if (format[0] == '@' || format[0] == '=')
        format++;
    if (view->itemsize != 8 || format[0] == '\0' || format[1] != '\0')
        return false;
    return element == 'd' ? format[0] == 'd' : format[0] == 'l' || format[0] == 'q';
}

/* Say why an array does not fit; nothing where it does. */
static const char *misfit(const buffer_view *view, const parameter *wanted)
{
    if (view->ndim != wanted->dimensions)
        return "has another number of dimensions";
    if (!has_format(view, wanted->kind))
        return wanted->kind == 'd' ? "is not of float64" : "is not of int64";
    if (!py.is_contiguous(view, 'C'))
        return "is not contiguous, in C order";
    if (wanted->written && view->readonly)
        return "is read-only";
    if ((uintptr_t)view->buf % 8 != 0)
        return "does not begin at a multiple of 8 bytes";
    return NULL;
}

/* Take one argument; return whether it fits, else the error is set. */
static bool take_argument(const kernel *called, int number, object *given, argument *taken, buffer_view *view)
{
    const parameter *wanted = &called->parameters[number];
    view->obj = NULL;
    view->len = 0;
    if (wanted->dimensions == 0) {
        if (wanted->kind == 'd')
            taken->d = py.as_double(given);
        else if (wanted->kind == 'b')
            taken->i = py.is_true(given);
        else
            taken->i = py.as_whole(given);
        return py.error_occurred() == NULL;
    }
    if (py.get_buffer(given, view, WITH_FORMAT | WITH_STRIDES) != 0) {
        view->obj = NULL;
        py.set_error(py.type_error, "%s: %s is no array", called->name, wanted->name);
        return false;
    }
    if (!wanted->written && !py.is_contiguous(view, 'C')) { /* what is only read may be read from a copy */
        py.release_buffer(view);
        object *copy = py.call(py.contiguous, given, NULL);
        bool failed = copy == NULL || py.get_buffer(copy, view, WITH_FORMAT | WITH_STRIDES) != 0;
        if (failed)
            view->obj = NULL;
        if (copy)
            py.let_go(copy); /* the view holds it */
        if (failed)
            return false;
    }
    const char *reason = misfit(view, wanted);
    if (reason) {
        py.set_error(py.type_error, "%s: %s %s", called->name, wanted->name, reason);
        return false;
    }
    taken->p = view->buf;
    for (int axis = 0; axis < view->ndim; axis++)
        taken->n[axis] = view->shape[axis];
    return true;
}

static object *one_result(char kind, const argument *result)
{
    if (kind == 'd')
        return py.from_double(result->d);
    return kind == 'b' ? py.from_truth((long)result->i) : py.from_whole(result->i);
}

static object *results_of(const kernel *called, const argument *results)
{
    intptr_t count = called->result_count;
    if (count == 1)
        return one_result(called->results[0], results);
    object *tuple = py.new_tuple(count);
    for (intptr_t i = 0; tuple && i < count; i++)
        py.set_item(tuple, i, one_result(called->results[i], &results[i]));
    return tuple;
}

/* The function of a kernel that is the fastest one for these arguments; all give the same bits. */
static runner chosen(long long number, const argument *arguments)
{
    if (number >= FIRST_OF_LANES)
        return lanes[number - FIRST_OF_LANES];
    if (!descriptions[number].of_state || arguments[0].n[0] * (int64_t)sizeof(int64_t) < (int64_t)sizeof(StateInts))
        return kernels[number]; /* of too short an array the runner says so */
    return is_small(arguments[0].p) ? kernels_plain[number] : kernels[number];
}

/* Bytes of a kernel's arrays, those of a state apart, from which it lets other threads run meanwhile: a thousand
   numbers.  It takes microseconds for fewer, and a thread that waits for the interpreter afterwards waits for tens. */
enum { LONG = 8000, STATE_ARRAYS = 5 };

static object *call(object *self, object *const *given, intptr_t count)
{
    const long long number = py.as_whole(self);
    const kernel *called = &descriptions[number];
    argument arguments[MOST_ARGUMENTS];
    buffer_view views[MOST_ARGUMENTS];
    object *result = NULL;
    const int wanted = called->count;
    bool fits = true;
    int taken = 0;
    intptr_t bytes = 0;
    arguments[0].n[0] = 0; /* a kernel without arguments has no state */
    if (count != wanted)
        return py.set_error(py.type_error, "%s takes %d arguments, not %d", called->name, wanted, (int)count);
    while (fits && taken < wanted) { /* the last one may be an array that does not fit */
        fits = take_argument(called, taken, given[taken], &arguments[taken], &views[taken]);
        if (!called->of_state || taken >= STATE_ARRAYS)
            bytes += views[taken].len;
        taken++;
    }
    if (fits) {
        void *thread = bytes >= LONG ? py.let_others_run() : NULL;
        const char *broken = chosen(number, arguments)(arguments);
        if (thread)
            py.take_back(thread);
        if (broken)
            py.set_error(py.value_error, "%s: it must hold that %s", called->name, broken);
        else
            result = results_of(called, arguments);
    }
    for (int i = 0; i < taken; i++)
        if (called->parameters[i].dimensions > 0 && views[i].obj)
            py.release_buffer(&views[i]);
    return result;
}

/* Take one sample: (u, y, t, r), by the table that `replant.kernels.native.Library.step` has made.  Raises Attention,
   and takes none, where the gate is shut or the identifier has something to do first; the interpreter is not free
   between the look and the sample, so that no other thread comes between.  The class lies beside the table: a process
   that has imported the package twice has two. */
static object *step(object *self, object *const *given, intptr_t count)
{
    const int64_t *table = (const int64_t *)(void *)py.bytes_of(py.get_item(self, 0));
    double sample[4];
    if (count != 4) {
        py.set_error_text(py.type_error, "a step takes four numbers: u, y, t and r");
        return NULL;
    }
    for (int i = 0; i < 4; i++) {
        sample[i] = py.as_double(given[i]);
        if (sample[i] == -1.0 && py.error_occurred())
            return NULL;
    }
    State own = {
        (StateInts *)(intptr_t)table[INTS], table[INTS + 1], (StateReals *)(intptr_t)table[REALS], table[REALS + 1],
        { (double *)(intptr_t)table[BANKS], table[BANKS + 1], table[BANKS + 2] },
        { (double *)(intptr_t)table[BUFFER], table[BUFFER + 1], table[BUFFER + 2] },
        { (double *)(intptr_t)table[RECENT], table[RECENT + 1], table[RECENT + 2] },
    };
    const StateInts *ints = own.ints;
    bool collects = steps[table[KIND]].collects;
    if (table[GATE] == SHUT || ints->attention == 1 || (collects && ints->samples + 1 == ints->attention_at)) {
        py.set_error_text(py.get_item(self, 1), "");
        return NULL;
    }
    taker take = is_small(ints) ? takers_plain[table[KIND]] : takers[table[KIND]];
    double error = take(&own, sample[0], sample[1], sample[2], sample[3]);
    if (ints->held_at == at_BELIEVED) { /* one that was held back comes first */
        py.set_error_text(py.get_item(self, 1), "");
        return NULL;
    }
    return py.from_double(error);
}

static const definition call_definition = { "kernel", call, FAST_CALL, "A compiled kernel." };
static const definition step_definition = { "step", step, FAST_CALL, "Take one sample." };

EXPORTED const char *replant_source(void) { return &"replant-source:" REPLANT_SOURCE[15]; }
EXPORTED int replant_count(void) { return ALL_KERNELS; }
EXPORTED const char *replant_name(int number) { return descriptions[number].name; }
EXPORTED const void *replant_call_definition(void) { return &call_definition; }
EXPORTED const void *replant_step_definition(void) { return &step_definition; }

EXPORTED int replant_step_number(const char *name)
{
    for (int i = 0; i < (int)(sizeof steps / sizeof *steps); i++)
        if (strcmp(steps[i].name, name) == 0)
            return i;
    return -1;
}

EXPORTED void replant_connect(const python *functions)
{
    py = *functions;
    choose();
}
