/* One argument as Python gave it: where an array begins and its sizes, or a number. */
typedef struct {
    void *p;
    int64_t n[3];
    int64_t i;
    double d;
} argument;

/* Runs a kernel; returns what does not hold of its arguments, or nothing.  The result takes the place of the first. */
typedef const char *(*runner)(argument *);

/* What is compiled for several instruction sets has the name of one behind its own. */
#define JOINED(name, variant) name##_##variant
#define NAMED(name, variant) JOINED(name, variant)
#define OF_VARIANT(name) NAMED(name, VARIANT)
